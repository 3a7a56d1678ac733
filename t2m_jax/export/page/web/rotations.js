// Rotations as quaternions [x, y, z, w], as in glTF.

import { cross, dot, length, scaled, subtract, unit } from "./vectors.js";

export const IDENTITY = [0, 0, 0, 1];
const SQUARINGS = 40;

export const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export const rotate = (turn, [x, y, z]) => multiply(multiply(turn, [x, y, z, 0]), inverse(turn)).slice(0, 3);

// Returns the shortest rotation from one direction to another.
export function between(from, to) {
  const [a, b] = [unit(from), unit(to)];
  const cosine = dot(a, b);
  if (cosine < -1 + 1e-9) { // opposite: about any axis across
    const across = unit(cross(a, Math.abs(a[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0]));
    return [...across, 0];
  }
  return unit([...cross(a, b), 1 + cosine]);
}

// Returns the rotation on the shorter way from `a` to `b`, at a share of it.
export function slerp(a, b, share) {
  const nearer = dot(a, b) < 0 ? scaled(b, -1) : b;
  const angle = 2 * Math.atan2(length(subtract(nearer, a)), length(a.map((value, place) => value + nearer[place])));
  if (Math.sin(angle) < 1e-4) return unit(a.map((value, place) => (1 - share) * value + share * nearer[place]));
  const [before, after] = [Math.sin((1 - share) * angle), Math.sin(share * angle)];
  return unit(a.map((value, place) => before * value + after * nearer[place]));
}

// Returns the rotation that brings vectors closest to others by least squares: the largest eigenvector of a matrix (Horn 1987).
export function bestRotation(from, to) {
  const [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = [0, 1, 2].map((row) => [0, 1, 2].map((column) => from.reduce((total, vector, place) => total + vector[row] * to[place][column], 0)));
  let matrix = [
    [xx - yy - zz, xy + yx, zx + xz, yz - zy],
    [xy + yx, yy - xx - zz, yz + zy, zx - xz],
    [zx + xz, yz + zy, zz - xx - yy, xy - yx],
    [yz - zy, zx - xz, xy - yx, xx + yy + zz],
  ];
  // With no negative eigenvalue, each square has more of the largest one, until nothing else is left.
  const size = length(matrix.flat()) || 1;
  matrix = matrix.map((row, place) => row.map((value, column) => value / size + Number(place === column)));
  for (let round = 0; round < SQUARINGS; round += 1) {
    const square = matrix.map((row) => matrix.map((other) => dot(row, other)));
    const norm = length(square.flat());
    matrix = square.map((row) => scaled(row, 1 / norm));
  }
  return unit(matrix.toSorted((a, b) => dot(b, b) - dot(a, a))[0]);
}

// Returns the angles of the rotations about Z, X and Y in radians, of which that about Y comes first.
export function eulerOf([x, y, z, w]) {
  const first = Math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z));
  const middle = Math.atan2(2 * (y * z + w * x), Math.hypot(1 - 2 * (x * x + y * y), 2 * (x * z - w * y)));
  const [cosine, sine] = [Math.cos(first), Math.sin(first)];
  const across = cosine * 2 * (x * z + w * y) + sine * 2 * (y * z - w * x);
  const along = cosine * (1 - 2 * (y * y + z * z)) + sine * 2 * (x * y + w * z);
  return [first, middle, Math.atan2(across, along)];
}
