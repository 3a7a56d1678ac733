"""Rotations as quaternions `(w, x, y, z)`, matrices, 6D vectors and Euler angles.

Rotations are active and apply to column vectors. `quaternion_multiply(a, b)` rotates by `b` first. All functions accept
NumPy or JAX arrays with leading batch axes, and return float32 arrays of the same library (`turned_about_y`: in the
precision of its arguments). Finite inputs give finite results.
"""

from typing import Any, Literal

import chex
from jaxtyping import Float

from t2m_jax.motion.namespace import AnyArray, namespace_of

EulerOrder = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]

_TINY = 1e-30  # smaller than any meaningful length, but larger than the smallest float32


def _dot(a: Float[AnyArray, "*#batch C"], b: Float[AnyArray, "*#batch C"]) -> Float[AnyArray, "*batch 1"]:
    """Returns the inner products along the last axis, which keeps size 1."""
    return namespace_of(a, b).sum(a * b, axis=-1, keepdims=True)


def _float32(*arrays: AnyArray) -> tuple[Any, ...]:
    """Returns the library of `arrays`, and then each of them in it as float32."""
    xp: Any = namespace_of(*arrays)
    return (xp, *(xp.asarray(array, dtype=xp.float32) for array in arrays))


def unit_vectors(vectors: Float[AnyArray, "*batch C"]) -> Float[AnyArray, "*batch C"]:
    """Returns `vectors` with unit length, in the precision of the input. Zero vectors stay zero."""
    xp = namespace_of(vectors)
    # Dividing by the largest entry first prevents underflow in the square of a short vector. The divisors of a zero
    # vector are not tiny, because XLA of JAX 0.8 to 0.10 divides once by the product of several divisors, here 0.
    largest = xp.max(xp.abs(vectors), axis=-1, keepdims=True)
    scaled = vectors / xp.where(largest > 0, largest, 1)
    return scaled / xp.sqrt(xp.maximum(_dot(scaled, scaled), 0.5))


def cross_product(a: Float[AnyArray, "*#batch 3"], b: Float[AnyArray, "*#batch 3"]) -> Float[AnyArray, "*batch 3"]:
    """Returns the cross products along the last axis, in the precision of the inputs."""
    chex.assert_shape([a, b], (..., 3))
    xp = namespace_of(a, b)
    ax, ay, az = (a[..., i] for i in range(3))
    bx, by, bz = (b[..., i] for i in range(3))
    return xp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def quaternion_multiply(
    a: Float[AnyArray, "*#batch 4"], b: Float[AnyArray, "*#batch 4"]
) -> Float[AnyArray, "*batch 4"]:
    """Returns the Hamilton products `a * b`: the rotation by `b`, then by `a`."""
    chex.assert_shape([a, b], (..., 4))
    xp, a, b = _float32(a, b)
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return xp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quaternion_inverse(quaternions: Float[AnyArray, "*batch 4"]) -> Float[AnyArray, "*batch 4"]:
    """Returns the conjugates, which are the inverses of unit quaternions."""
    chex.assert_shape(quaternions, (..., 4))
    xp, quaternions = _float32(quaternions)
    return xp.concatenate([quaternions[..., :1], -quaternions[..., 1:]], axis=-1)


def rotate_vectors(
    quaternions: Float[AnyArray, "*#batch 4"], vectors: Float[AnyArray, "*#batch 3"]
) -> Float[AnyArray, "*batch 3"]:
    """Returns `vectors` rotated by unit `quaternions`."""
    chex.assert_shape([quaternions, vectors], [(..., 4), (..., 3)])
    _, quaternions, vectors = _float32(quaternions, vectors)
    w = quaternions[..., :1]
    u = quaternions[..., 1:]
    # q v q* without the products that cancel: v + 2 w (u × v) + 2 u × (u × v).
    uv = cross_product(u, vectors)
    return vectors + 2 * (w * uv + cross_product(u, uv))


def quaternion_between(a: Float[AnyArray, "*#batch 3"], b: Float[AnyArray, "*#batch 3"]) -> Float[AnyArray, "*batch 4"]:
    """Returns the smallest rotations from the directions `a` to the directions `b`, with w >= 0.

    Lengths do not matter. Exactly opposite directions give half a turn about an arbitrary axis perpendicular to them. A
    zero vector gives the identity.
    """
    chex.assert_shape([a, b], (..., 3))
    xp, a, b = _float32(a, b)
    a = unit_vectors(a)
    b = unit_vectors(b)
    cosine = _dot(a, b)
    # Near opposite directions, a × b and 1 + cos cancel. a × (a + b) and sin² / (1 − cos) are equal and do not.
    axis = cross_product(a, xp.where(cosine < 0, a + b, b))
    sine_squared = _dot(axis, axis)
    real = xp.where(cosine < 0, sine_squared / (1 + xp.abs(cosine)), 1 + cosine)
    opposite = (cosine < 0) & (sine_squared < 1e-13)
    # Crossed with X, or with Y if the direction is nearly X: either is far from parallel.
    x, y, z = (a[..., i : i + 1] for i in range(3))
    zero = xp.zeros_like(x)
    perpendicular = xp.where(
        xp.abs(x) < 0.8, xp.concatenate([zero, z, -y], axis=-1), xp.concatenate([-z, zero, x], axis=-1)
    )
    real = xp.where(opposite, xp.zeros_like(real), real)
    axis = xp.where(opposite, perpendicular, axis)
    return unit_vectors(xp.concatenate([real, axis], axis=-1))


def matrix_from_quaternion(quaternions: Float[AnyArray, "*batch 4"]) -> Float[AnyArray, "*batch 3 3"]:
    """Returns rotation matrices. The length of the quaternions does not matter."""
    chex.assert_shape(quaternions, (..., 4))
    xp, quaternions = _float32(quaternions)
    scale = 2 / xp.maximum(_dot(quaternions, quaternions)[..., 0], _TINY)
    w, x, y, z = (quaternions[..., i] for i in range(4))
    xs, ys, zs = (part * scale for part in (x, y, z))
    rows = (
        (1 - (y * ys + z * zs), x * ys - w * zs, x * zs + w * ys),
        (x * ys + w * zs, 1 - (x * xs + z * zs), y * zs - w * xs),
        (x * zs - w * ys, y * zs + w * xs, 1 - (x * xs + y * ys)),
    )
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_matrix(matrices: Float[AnyArray, "*batch 3 3"]) -> Float[AnyArray, "*batch 4"]:
    """Returns the unit quaternions of rotation matrices, with w >= 0."""
    chex.assert_shape(matrices, (..., 3, 3))
    xp, matrices = _float32(matrices)
    m = [[matrices[..., i, j] for j in range(3)] for i in range(3)]
    # Each name is four times the product of two components: wx is 4 w x.
    wx = m[2][1] - m[1][2]
    wy = m[0][2] - m[2][0]
    wz = m[1][0] - m[0][1]
    xy = m[0][1] + m[1][0]
    xz = m[0][2] + m[2][0]
    yz = m[1][2] + m[2][1]
    ww = 1 + m[0][0] + m[1][1] + m[2][2]
    xx = 1 + m[0][0] - m[1][1] - m[2][2]
    yy = 1 - m[0][0] + m[1][1] - m[2][2]
    zz = 1 - m[0][0] - m[1][1] + m[2][2]
    # Each row of 4 q qᵀ is a multiple of the quaternion. The row with the largest diagonal entry is the most accurate.
    rows = ((ww, wx, wy, wz), (wx, xx, xy, xz), (wy, xy, yy, yz), (wz, xz, yz, zz))
    products = xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
    largest = xp.argmax(xp.stack([ww, xx, yy, zz], axis=-1), axis=-1)
    quaternions = unit_vectors(xp.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :])
    return xp.where(quaternions[..., :1] < 0, -quaternions, quaternions)


def rotation_6d_from_quaternion(quaternions: Float[AnyArray, "*batch 4"]) -> Float[AnyArray, "*batch 6"]:
    """Returns the first and the second column of each quaternion's matrix."""
    matrices = matrix_from_quaternion(quaternions)
    return namespace_of(matrices).concatenate([matrices[..., 0], matrices[..., 1]], axis=-1)


def continuous_quaternions(quaternions: Float[AnyArray, "T *batch 4"]) -> Float[AnyArray, "T *batch 4"]:
    """Returns the same rotations, with signs for which consecutive quaternions have inner products >= 0."""
    chex.assert_shape(quaternions, (..., 4))
    xp, quaternions = _float32(quaternions)
    # A sign depends on all flips before it, so the product of the flips so far is the sign.
    flips = xp.where(_dot(quaternions[1:], quaternions[:-1]) < 0, xp.float32(-1), xp.float32(1))
    signs = xp.concatenate([xp.ones_like(quaternions[:1, ..., :1]), xp.cumprod(flips, axis=0)], axis=0)
    return quaternions * signs


def matrix_from_euler(angles: Float[AnyArray, "*batch 3"], order: EulerOrder) -> Float[AnyArray, "*batch 3 3"]:
    """Returns rotation matrices of Euler angles in radians, given in the order of the letters.

    "ZXY" means Rz(angles[0]) @ Rx(angles[1]) @ Ry(angles[2]), so the rotation of the last letter is applied first.
    """
    chex.assert_shape(angles, (..., 3))
    xp, angles = _float32(angles)
    cosines = xp.cos(angles / 2)
    sines = xp.sin(angles / 2)
    zero = xp.zeros_like(angles[..., 0])
    turns = []
    for number, letter in enumerate(order):
        around: list[Any] = [sines[..., number] if letter == axis else zero for axis in "XYZ"]
        turns.append(xp.stack([cosines[..., number], *around], axis=-1))
    return matrix_from_quaternion(quaternion_multiply(quaternion_multiply(turns[0], turns[1]), turns[2]))


def euler_from_matrix(matrices: Float[AnyArray, "*batch 3 3"], order: EulerOrder) -> Float[AnyArray, "*batch 3"]:
    """Returns Euler angles in radians in the order of the letters. The middle one is between -π/2 and π/2.

    The angles always give the same matrix, even if the middle one is ±π/2 and the others are not unique.
    """
    chex.assert_shape(matrices, (..., 3, 3))
    xp, matrices = _float32(matrices)
    i, j, k = ("XYZ".index(letter) for letter in order)
    # The formulas are those of a cyclic order; in the others, sines have the other sign.
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    first = xp.arctan2(-sign * matrices[..., j, k], matrices[..., k, k])
    middle = xp.arctan2(sign * matrices[..., i, k], xp.hypot(matrices[..., i, i], matrices[..., i, j]))
    # The third angle is read after undoing the first rotation. Their sum is then right even if neither is determined.
    cos = xp.cos(first)
    sin = sign * xp.sin(first)
    third = xp.arctan2(
        sign * (cos * matrices[..., j, i] + sin * matrices[..., k, i]),
        cos * matrices[..., j, j] + sin * matrices[..., k, j],
    )
    return xp.stack([first, middle, third], axis=-1)


def slerp(
    a: Float[AnyArray, "*#batch 4"], b: Float[AnyArray, "*#batch 4"], weight: float | Float[AnyArray, "*#batch"]
) -> Float[AnyArray, "*batch 4"]:
    """Returns unit quaternions on the shorter arc from `a` to `b`, at the fraction `weight` (0 … 1) of the angle."""
    chex.assert_shape([a, b], (..., 4))
    xp, a, b = _float32(a, b)
    share = xp.asarray(weight, dtype=xp.float32)
    share = share[..., None] if share.ndim else share
    # q and -q are one rotation; the arc to the nearer of the two is the shorter one.
    b = xp.where(_dot(a, b) < 0, -b, b)
    difference = b - a
    # Computed from the chord, because arccos is not accurate for small angles.
    angle = 2 * xp.arctan2(xp.sqrt(_dot(difference, difference)), xp.sqrt(_dot(a + b, a + b)))
    sine = xp.sin(angle)
    near = sine < 1e-4  # then sin(share * angle) / sine is the share, and its division would not be accurate
    safe = xp.where(near, xp.ones_like(sine), sine)
    weight_a = xp.where(near, 1 - share, xp.sin((1 - share) * angle) / safe)
    weight_b = xp.where(near, share * xp.ones_like(sine), xp.sin(share * angle) / safe)
    return unit_vectors(weight_a * a + weight_b * b)


def turned_about_y(
    vectors: Float[AnyArray, "*batch 3"], turns: Float[AnyArray, "*#batch"]
) -> Float[AnyArray, "*batch 3"]:
    """Returns vectors turned about Y, by radians from +Z to +X."""
    xp = namespace_of(vectors)
    x, y, z = xp.moveaxis(vectors, -1, 0)
    cosine = xp.cos(turns)
    sine = xp.sin(turns)
    return xp.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
