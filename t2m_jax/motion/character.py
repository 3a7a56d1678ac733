"""Motion on the user's own character: a GLB or VRM file that gets further animations, with all that it has already."""

import copy
import dataclasses
import functools
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_bytes
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.glb_file import GlbChunks, GlbWriter, Track, check_motions, reading_glb, split_chunks
from t2m_jax.motion.gltf_nodes import Nodes, bind_pose, find_nodes, rest_clip, same_rotation
from t2m_jax.motion.gltf_transforms import is_uneven, without_matrix
from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.placing import place_joints
from t2m_jax.motion.rig.retarget import find_rig, match_clip
from t2m_jax.motion.rig.transfer import Movement, transfer
from t2m_jax.motion.rotations import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

logger = logging.getLogger(__name__)

ENDS = ("head", "left_wrist", "right_wrist", "left_foot", "right_foot")
"""Joints whose rotations are not known. Their bones keep their rest pose."""
LEVEL = 0.5
"""A trunk is level if it is less than this along the vertical (cosine)."""
_FLOOR = np.array([1.0, 0.0, 1.0])


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Character:
    """A figure of another program, whose bones are matched with the joints of motions."""

    path: Path
    """Its file."""
    glb: GlbChunks
    """What is in the file."""
    nodes: Nodes
    """The joints, and what is above them, in the rest pose."""
    saved_rotations: Float[np.ndarray, "J 4"]
    """Their rotations in the file, which may be those of another pose."""
    clip: RigClip
    """The rest pose."""
    index: Mapping[str, int]
    """Joints of HumanML3D -> places in `nodes`."""

    def save(self, path: Path | str, motions: Sequence[Motion]) -> None:
        """Writes the file of the character with an animation for each motion.

        Mesh, skin, textures, morphs and other animations stay as they are.

        Args:
            path: The file.
            motions: Motions of the 22 joints, at least one.

        Raises:
            UserError: There is no motion, one has another skeleton, or the file cannot be written or is the original.
        """
        path = Path(path)
        check_motions(path, motions)
        self.check_copy(path)
        animations = [self._tracks(motion) for motion in motions]
        with reading_glb(self.path):
            glb = GlbWriter(self.glb)
            glb.tree["nodes"] = copy.deepcopy(glb.tree["nodes"])
            for motion, (tracks, scale) in zip(motions, animations, strict=True):
                glb.add_animation(motion, tracks, scale=scale)
            for track in animations[0][0]:
                without_matrix(glb.tree["nodes"][track.node])
            data = glb.data()
        with atomic_file(path) as partial:
            partial.write_bytes(data)

    def check_copy(self, path: str | Path) -> None:
        """Raises `UserError` if a path is not that of another `.glb` file."""
        path = Path(path)
        if path.suffix.lower() != ".glb":
            raise UserError(f"{path}: a character is written as .glb file, not {path.suffix or 'without a suffix'}")
        if path.exists() and path.samefile(self.path):
            raise UserError(f"{path}: is the character's own file; write a copy of another name")

    def _tracks(self, motion: Motion) -> tuple[list[Track], float]:
        """Returns the animation of a motion: where the figure is, and rotations of its bones; and the scale of both."""
        rest = self.rest
        movement = transfer(motion, rest, self.index)
        moved = self.moved
        (top,) = (place for place, joint in moved.items() if joint == 0)
        start = self.clip.poses.positions[0, top]
        places = movement.pelvis + rotate_vectors(movement.turns[:, 0], start - rest[0])
        return [*self._places(top, places, start), *self._turns(movement, moved)], movement.scale

    @property
    def rest(self) -> Float[np.ndarray, "22 3"]:
        """The joints of HumanML3D in the rest pose."""
        return place_joints(self.clip.positions, self.nodes.parents, self.index)[0]

    def _places(self, top: int, places: Float[np.ndarray, "T 3"], start: Float[np.ndarray, "3"]) -> Iterator[Track]:
        """Yields the translations that put the highest bone that moves at places of the world."""
        # A root bone takes with it what is not the figure's body: helpers of feet, a cape, badly weighted vertices.
        line = line_to(top, self.nodes.parents)[:-1]
        skinned = {joint for skin in self.glb.tree.get("skins", []) for joint in skin["joints"]}
        root = next((place for place in line if self.numbers[place] in skinned), None)
        if root is not None:
            travel = (places - start) * _FLOOR
            yield self._translation(root, self.clip.poses.positions[0, root] + travel)
            places = places - travel
        yield self._translation(top, places)

    def _translation(self, place: int, places: Float[np.ndarray, "T 3"]) -> Track:
        """Returns the translation that puts a node at places of the world, with those above it in their rest pose."""
        parent = self.nodes.parents[place]
        if parent >= 0:
            poses = self.clip.poses
            turned = quaternion_from_matrix(poses.rotations[0, parent])
            places = rotate_vectors(quaternion_inverse(turned), places - poses.positions[0, parent])
        return Track(self.numbers[place], "translation", places / self.nodes.scales[place])

    def _turns(self, movement: Movement, moved: Mapping[int, int]) -> Iterator[Track]:
        """Yields rotations of nodes, each of which turns in the world as a joint of HumanML3D."""
        nodes = self.nodes
        rest = quaternion_from_matrix(self.clip.poses.rotations[0])
        world: dict[int, Any] = {-1: np.array([[1.0, 0.0, 0.0, 0.0]], np.float32)}
        for place in sorted({above for one in moved for above in line_to(one, nodes.parents)}):
            above = world[nodes.parents[place]]
            if place in moved:
                world[place] = quaternion_multiply(movement.turns[:, moved[place]], rest[place])
                local = quaternion_multiply(quaternion_inverse(above), world[place])
                yield Track.of_rotation(self.numbers[place], local)
            else:
                world[place] = quaternion_multiply(above, nodes.rotations[place])
        for place, number in self.numbers.items():
            if place not in moved and not same_rotation(nodes.rotations[place], self.saved_rotations[place]):
                yield Track.of_rotation(number, np.tile(nodes.rotations[place], (len(movement.turns), 1)))

    @functools.cached_property
    def numbers(self) -> dict[int, int]:
        """Numbers in the file of the places in `nodes`."""
        return {place: number for number, place in self.nodes.numbers.items()}

    @functools.cached_property
    def moved(self) -> dict[int, int]:
        """Returns the nodes that the animation turns -> the joint of HumanML3D whose rotation they get."""
        lines = [line_to(place, self.nodes.parents) for place in self.index.values()]
        # In some files, the spine is beside the pelvis: then what is above both moves as the pelvis does.
        above = os.path.commonprefix(lines)  # noqa: RUF071 - of lists, not paths
        if not above:
            raise UserError("no bone is above all of its limbs; give the figure one root")
        moved = {above[-1]: 0}
        for name, place in self.index.items():
            if name not in ("pelvis", *ENDS):
                moved.setdefault(place, JOINT[name])
        return moved


def load_character(path: Path | str, *, rig: str | None = None) -> Character:
    """Returns the character of a GLB or VRM file.

    Args:
        path: The file.
        rig: Name of a rig or a YAML table with joints of the file, such as `pelvis: Hips`; by default the joints are
            recognized.

    Raises:
        UserError: The file cannot be read, is damaged, or has no figure of a person. The message names the bones that
            were not found.
    """
    path = Path(path)
    data = load_bytes(path)
    with reading_glb(path):
        glb = split_chunks(data)
        _check_arrays(glb)
        saved = find_nodes(glb.tree)
        nodes = bind_pose(glb, saved)
        # A character may have any proportions, so it is not compared with people.
        clip = dataclasses.replace(rest_clip(nodes), is_person=True)
        table = find_rig(clip, rig)
        index = match_clip(clip, table)
        character = Character(path, glb, nodes, saved.rotations, clip, index)
        _check_rest(character, is_given=rig is not None)
    for note in filter(None, (*nodes.notes, table.note)):
        logger.info("%s: %s", path, note)
    return character


def _check_arrays(glb: GlbChunks) -> None:
    """Raises an error for a file that is no character, or that nothing can be added to."""
    if not (glb.tree.get("skins") or glb.tree.get("meshes")):
        raise UserError("has no skin and no mesh, so it is not a character; give the file of a figure")
    buffers = glb.tree.get("buffers", [])
    if buffers and "uri" in buffers[0]:
        raise UserError("its data are in another file; export everything into one .glb")
    if buffers and not 0 <= buffers[0]["byteLength"] <= len(glb.binary):
        raise ValueError("its binary data are cut off")
    for name in ("buffers", "bufferViews", "accessors", "animations"):
        if not isinstance(glb.tree.get(name, []), list):
            raise ValueError(f"{name} is not a list")


def _check_rest(character: Character, *, is_given: bool) -> None:
    """Raises an error for a rest pose that cannot be moved."""
    joints = dict(zip(HUMANML3D.joint_names, character.rest, strict=True))
    for upper, lower in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left", "right"):
            if not np.linalg.norm(joints[f"{side}_{upper}"] - joints[f"{side}_{lower}"]) > 0:
                raise UserError(f"its {side} {upper} and {lower} are at the same place; --rig TABLE gives other bones")
    for place, number in character.numbers.items():
        if not character.nodes.scales[place] > 0 or is_uneven(character.glb.tree["nodes"][number]):
            name = character.nodes.names[place]
            raise UserError(f"the scale of {name!r} is zero, mirrored or uneven; apply scales before the export")
    trunk = joints["neck"] - joints["pelvis"]
    if not (is_given or abs(trunk[1]) >= LEVEL * np.linalg.norm(trunk)):
        raise UserError("its trunk is level in the rest pose, as an animal's; --rig TABLE takes it as a person")
    character.moved  # noqa: B018 - raises an error
