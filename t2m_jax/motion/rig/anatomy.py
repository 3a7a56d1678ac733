"""The joints of a person in a hierarchy that no table knows: found by names, and by how a body is built."""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.rig.placing import SPINE_HEIGHTS
from t2m_jax.motion.rig.words import JointWords, read_names

LEG = ("hip", "knee", "ankle")
ARM = ("shoulder", "elbow", "wrist")
MAX_LIMB = 16
"""Most joints of one line from the trunk to a tip that are compared."""
MAX_UNEVEN = 0.4
"""Largest ratio of the two bones of a limb whose end has no known name (logarithm); people have up to 0.25."""
HEAD_UP = 0.24
"""A head is higher above the shoulders than this part of the trunk, and a neck is not."""
MIN_DISTANCE = 0.2
"""Two figures whose tops are nearer than this part of a leg are the same person."""
MIN_TIP = 0.05
"""A joint that is nearer than this part of the shin or of the spine to the one before it is at the same place."""
FOOT = 0.33
"""Length of a foot, from ankle to ball, in shins."""
_SPINE_PLACES = {name: SPINE_HEIGHTS[name] / SPINE_HEIGHTS["neck"] for name in ("spine1", "spine2", "spine3")}
"""Parts of the way from the pelvis to the neck."""

Limb = tuple[int, int, int]
"""The three joints of a leg or an arm."""
Kind = tuple[str, tuple[str, str, str]]
"""A side, and `LEG` or `ARM`."""


class RigFigure(NamedTuple):
    """The legs and arms of a person or an animal."""

    top: int
    """The last joint above all of them."""
    limbs: Mapping[str, int]
    """Joints of HumanML3D -> joints."""
    evidence: float
    """How clearly names and lengths mean these limbs, up to 24."""


class Bones(NamedTuple):
    """A hierarchy with what its names say. Joints come after their parents."""

    names: Sequence[str]
    offsets: Float[np.ndarray, "J 3"]
    """Each joint in its parent's frame, in any unit."""
    words: Sequence[JointWords]
    lines: Sequence[Sequence[int]]
    """The joints from the root to each joint."""
    reaches: Float[np.ndarray, " J"]
    """Length of the bones from the root to each joint."""

    def length(self, above: int, below: int) -> float:
        """Returns the length of the bones from a joint to one below it."""
        return float(self.reaches[below] - self.reaches[above])

    def meeting(self, *joints: int) -> int:
        """Returns the last joint that is above all of these, or is one of them."""
        levels = zip(*(self.lines[joint] for joint in joints), strict=False)
        return [level[0] for level in levels if len(set(level)) == 1][-1]

    def below(self, joint: int) -> list[int]:
        """Returns the joints below a joint."""
        return [other for other, line in enumerate(self.lines) if joint in line[:-1]]


def make_bones(names: Sequence[str], parents: Sequence[int], offsets: Float[np.ndarray, "J 3"]) -> Bones:
    """Returns the hierarchy with what its names say."""
    offsets = np.asarray(offsets, np.float64)
    lengths = np.linalg.norm(offsets, axis=1)
    lines = [line_to(joint, parents) for joint in range(len(parents))]
    reaches = np.zeros(len(parents))
    for joint, parent in enumerate(parents):
        reaches[joint] = reaches[parent] + lengths[joint] if parent >= 0 else 0.0
    return Bones(names, offsets, _in_hierarchy(read_names(names), lines), lines, reaches)


def _in_hierarchy(words: Sequence[JointWords], lines: Sequence[Sequence[int]]) -> list[JointWords]:
    """Returns the words of joints, with what those above and below say.

    A joint between two of a side is of this side. `leg_end` is an ankle if joints are below it, and a tip otherwise.
    """
    below: list[set[str]] = [set() for _ in lines]
    for line in lines:
        for other in line[:-1]:
            below[other] |= set() if words[line[-1]].is_end else {words[line[-1]].side}
    found = list(words)
    for joint, sides in enumerate(below):
        if words[joint].is_end:
            last = LEG[2] if words[joint].parts.keys() & set(LEG) else ARM[2]
            found[joint] = dataclasses.replace(words[joint], parts={last: 2.0} if sides else {}, is_helper=not sides)
        sides = sides - {""}
        if not words[joint].side and len(sides) == 1 and sides <= {words[other].side for other in lines[joint]}:
            found[joint] = dataclasses.replace(found[joint], side=min(sides))
    return found


def find_joints(bones: Bones) -> dict[str, int]:
    """Returns the joints of HumanML3D that were recognized; those that the hierarchy lacks are left out.

    A limb is three joints of one side, one below the other, whose names mean its parts and whose two bones have about
    the same length. The pelvis is where the legs meet, the chest where the arms do, and the spine is between them.
    """
    found = next((dict(figure.limbs) for figure in find_figures(bones)), {})
    for side in ("left", "right"):
        if f"{side}_ankle" in found and (toe := _toe(bones, found, side)) is not None:
            found[f"{side}_foot"] = toe
    if {"left_hip", "right_hip"} <= found.keys():
        found["pelvis"] = bones.meeting(found["left_hip"], found["right_hip"])
    if "pelvis" in found and {"left_shoulder", "right_shoulder"} <= found.keys():
        _add_trunk(bones, found)
    return found


def find_figures(bones: Bones) -> list[RigFigure]:
    """Returns the figures that may be the person of a file, the likeliest first.

    If a file has people, its animals are left out. So are copies of the likeliest figure at its place: controls.
    """
    limbs = {kind: _limbs(bones, *kind) for kind in itertools.product(("left", "right"), (LEG, ARM))}
    kinds: list[set[Kind]] = [set() for _ in bones.names]
    for kind, found in limbs.items():
        for joint in {above for first in {limb[0] for limb in found} for above in bones.lines[first]}:
            kinds[joint].add(kind)
    most = max(map(len, kinds), default=0)
    whole = {joint for joint, own in enumerate(kinds) if own and len(own) == most}
    # The last joints that have all limbs below them: those of several people do not get mixed.
    tops = whole - {above for joint in whole for above in bones.lines[joint][:-1]}
    figures = sorted((_figure(bones, limbs, top) for top in tops), key=lambda one: (-one.evidence, one.top))
    animals = {above for joint, words in enumerate(bones.words) if words.is_animal for above in bones.lines[joint]}
    people = [figure for figure in figures if figure.top not in animals] or figures
    return [one for one in people if one == people[0] or _is_another(bones, people[0], one)]


def _figure(bones: Bones, limbs: Mapping[Kind, Mapping[Limb, float]], top: int) -> RigFigure:
    """Returns the likeliest limbs below a joint."""
    joints: dict[str, int] = {}
    evidence = 0.0
    below = {top, *bones.below(top)}
    hanging = Counter(above for line in bones.lines for above in line)
    for (side, roles), found in limbs.items():
        own = [limb for limb in found if limb[0] in below]
        if own:
            # Of joints at one place, the one on which others hang: controls may have bones of the mesh below them.
            best = max(own, key=lambda limb: (round(found[limb], 3), hanging[limb[2]]))
            joints |= {f"{side}_{role}": joint for role, joint in zip(roles, best, strict=True)}
            evidence += found[best]
    return RigFigure(top, joints, evidence)


def _is_another(bones: Bones, best: RigFigure, other: RigFigure) -> bool:
    """Returns whether a figure is as likely a person as the best one, and is at another place."""
    if len(other.limbs) < 2 * len(LEG + ARM) or other.evidence < best.evidence / 2:
        return False
    places = [bones.offsets[list(bones.lines[figure.top])].sum(axis=0) for figure in (best, other)]
    leg = bones.length(best.limbs["left_hip"], best.limbs["left_ankle"])
    return bool(np.linalg.norm(places[0] - places[1]) > MIN_DISTANCE * leg)


def _limbs(bones: Bones, side: str, roles: tuple[str, str, str]) -> dict[Limb, float]:
    """Returns the three joints of what may be a leg or an arm of a side -> how likely it is."""
    found = {}
    words = {joint: one for joint, one in enumerate(bones.words) if one.side == side and not one.is_helper}
    named = [joint for joint, one in words.items() if roles[2] in one.parts]
    # Without a hand or a foot, the lengths of bones tell where a limb ends: at a joint whose name says little.
    unclear = [joint for joint, one in words.items() if max(one.parts.values(), default=0.0) < 1]
    tips = [joint for joint, one in enumerate(bones.words) if one.side == side and one.is_end and one.is_helper]
    for end in named or unclear + tips:
        above = [joint for joint in bones.lines[end][:-1] if joint in words][-MAX_LIMB:]
        for first, second in itertools.combinations(above, 2):
            chosen = (first, second, end)
            evidence = [bones.words[joint].parts.get(role, 0.0) for joint, role in zip(chosen, roles, strict=True)]
            upper, lower = bones.length(first, second), bones.length(second, end)
            # One of the upper joints may have a name that is not known, but not both.
            if max(evidence[:2]) <= 0 or min(upper, lower) <= 0:
                continue
            uneven = abs(float(np.log(upper / lower)))
            # A thigh of two segments begins at the first; a joint beside the hip may have its name, too.
            late = sum(words[joint].parts == words[first].parts for joint in above[: above.index(first)])
            # A bone that is half as long as the other costs as much as a clear name gives.
            if named or uneven < MAX_UNEVEN:
                found[chosen] = sum(evidence) - 3 * uneven - 0.4 * late
    return found


def _toe(bones: Bones, found: Mapping[str, int], side: str) -> int | None:
    """Returns the joint at the ball of a foot, or the tip of a foot without one; None without anything there."""
    ankle = found[f"{side}_ankle"]
    shin = bones.length(found[f"{side}_knee"], ankle)

    def rank(joint: int) -> tuple[float, float, int, float]:
        words = bones.words[joint]
        toe = 0.0 if words.is_helper else words.parts.get("foot", 0.0) + 0.5 * words.parts.get("ankle", 0.0)
        # Of five toes, the one that reaches farthest is in the middle of the foot.
        return (toe, -float(words.is_helper), -len(bones.lines[joint]), bones.length(ankle, joint))

    far = [
        joint
        for joint in bones.below(ankle)
        if bones.words[joint].side in ("", side) and bones.length(ankle, joint) > MIN_TIP * shin
    ]
    if not far:
        return None
    toe = max(far, key=rank)
    # Second Life calls the ball of the foot a foot, and its tip a toe. That of usual length is taken.
    named = [joint for joint in far if joint in bones.lines[toe] and "ankle" in bones.words[joint].parts]
    return min([toe, *named], key=lambda joint: abs(np.log(bones.length(ankle, joint) / (FOOT * shin))))


def _add_trunk(bones: Bones, found: dict[str, int]) -> None:
    """Adds spine, neck, head and collars."""
    chest = bones.meeting(found["left_shoulder"], found["right_shoulder"])
    if "neck" in bones.words[chest].parts and chest != found["pelvis"]:
        # In older files of 3ds Max, the arms hang on the neck.
        chest = bones.lines[chest][-2]
    head = _head(bones, chest)
    above = bones.lines[head][bones.lines[head].index(chest) + 1 : -1] if head is not None else []
    if head is not None and not above and _is_above_neck(bones, found, chest, head):
        found["head"] = head
    elif head is not None:
        necks = [joint for joint in above if "neck" in bones.words[joint].parts] or above
        # A neck of length zero only marks the end of the chest. Without a neck, the head begins there.
        long = [joint for joint in necks if np.any(bones.offsets[joint] != 0)]
        found["neck"] = (long or necks or [head])[0]
        if found["neck"] != head:
            found["head"] = head
    for side in ("left", "right"):
        line = bones.lines[found[f"{side}_shoulder"]]
        above = [joint for joint in line[line.index(chest) + 1 : -1] if joint != found.get("neck")]
        between = [joint for joint in above if not bones.words[joint].is_helper]
        named = [joint for joint in between if "collar" in bones.words[joint].parts]
        if between:
            found[f"{side}_collar"] = (named or between)[-1]
    _add_spine(bones, found, chest)


def _is_above_neck(bones: Bones, found: Mapping[str, int], chest: int, head: int) -> bool:
    """Returns whether a joint on the chest is where the head begins, and not the neck."""
    # The joint `torso_head` is between both.
    if bones.words[head].parts.get("head", 0.0) < 2:
        return False
    lines = [bones.lines[found[f"{side}_shoulder"]] for side in ("left", "right")]
    # All three are in the frame of the chest. The neck is above the shoulders by 0.08 of the trunk, the head by 0.28.
    middle = np.mean([bones.offsets[line[line.index(chest) + 1]] for line in lines], axis=0)
    start = bones.meeting(chest, found["pelvis"])
    trunk = bones.length(start, chest) + float(np.linalg.norm(middle))
    return float(np.linalg.norm(bones.offsets[head] - middle)) > HEAD_UP * trunk


def _head(bones: Bones, chest: int) -> int | None:
    """Returns the head, or the last joint of a neck that ends without one."""
    plain = [joint for joint in bones.below(chest) if not (bones.words[joint].side or bones.words[joint].is_helper)]
    for part, place in (("head", 0), ("neck", -1)):
        named = [joint for joint in plain if part in bones.words[joint].parts]
        clearest = max((bones.words[joint].parts[part] for joint in named), default=0.0)
        if named:
            return [joint for joint in named if bones.words[joint].parts[part] == clearest][place]
    # Blender numbers the trunk up to the head (`spine.006`). In 3ds Max's CAT, the head is after the only such joint.
    spines = [joint for joint in plain if "spine" in bones.words[joint].parts]
    top = max(spines, key=lambda joint: len(bones.lines[joint]), default=None)
    return next((joint for joint in plain if spines == [top] == [bones.lines[joint][-2]]), top)


def _add_spine(bones: Bones, found: dict[str, int], chest: int) -> None:
    """Adds the joints of the spine that are nearest to where the template has them. The arms are at the last."""
    top, pelvis = found.get("neck", chest), found["pelvis"]
    # The spine may begin beside the pelvis, at a joint above both.
    start = bones.meeting(top, pelvis)
    line = bones.lines[top]
    inner = [joint for joint in line[line.index(start) + 1 :] if joint not in (found.get("neck"), pelvis)]
    whole = bones.length(start, top)
    if not inner or whole <= 0:
        return
    at = {joint: bones.length(start, joint) / whole for joint in inner}
    roles = list(_SPINE_PLACES)
    if chest in inner:
        found[roles.pop()] = chest
        inner = inner[: inner.index(chest)]
    inner = [joint for joint in inner if at[joint] > MIN_TIP][:MAX_LIMB]
    count = min(len(inner), len(roles))
    chosen = min(
        itertools.product(itertools.combinations(roles, count), itertools.combinations(inner, count)),
        key=lambda pair: sum(abs(at[joint] - _SPINE_PLACES[role]) for role, joint in zip(*pair, strict=True)),
    )
    found.update(zip(*chosen, strict=True))
