"""Reading the animations of a GLB file (glTF 2.0 in one binary file) as clips of a hierarchy of joints.

Scales are taken as constant, which they are in files of people.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_bytes
from t2m_jax.motion.glb_file import GlbChunks, free_name, own_extra, read_accessor, reading_glb, split_chunks
from t2m_jax.motion.gltf_nodes import Nodes, find_movers, find_nodes, moved_nodes, rest_clip, scaled_poses
from t2m_jax.motion.gltf_transforms import W_FIRST
from t2m_jax.motion.part_captions import checked_parts
from t2m_jax.motion.resampling import MAX_FPS
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.recognition import in_human_size
from t2m_jax.motion.rotations import slerp
from t2m_jax.motion.skeleton import HUMANML3D

MAX_SECONDS = 3600.0
"""A longer animation is taken as an error in the file."""
DENSE_FPS = 60.0
"""Rate to sample uneven keys at, for a filter that makes it lower: lines between keys bend at each key."""
MAX_POSES = 20_000_000
"""Joints times frames of all animations; an hour of 60 joints at 60 frames per second has 13 million."""
SAME_TIME = 1e-4
"""Keys of several tracks are at one time if less is between them; seconds."""
OFF_FRAME = 0.05
"""Keys may be this far from their frame; parts of a frame. Some programs write times with three decimals."""


class _Keyframes(NamedTuple):
    """The keys of one property of one node."""

    times: Float[np.ndarray, " K"]
    values: Float[np.ndarray, "K M C"]
    """M is 1, or 3 with cubic splines: tangent before the key, value, tangent after it."""
    interpolation: str


def load_gltf(path: Path | str, *, fps: float | None = None, at_keys: bool = True) -> dict[str, RigClip]:
    """Returns the animations of a GLB file by name. Equal names get a number.

    Lengths are in meters, as glTF demands, unless the file says that this package wrote centimeters.

    Args:
        path: The file.
        fps: Frames per second to sample the keys at. By default the rate that this package wrote into the file, and for
            other files that of their keys. If these are few or uneven, it is 20, after a filter.
        at_keys: Whether the rate of the keys is used; otherwise, it is 20 for all files of other programs.

    Raises:
        UserError: The file cannot be read, is damaged, or has no joints or no animation.
    """
    return _load(Path(path), list, fps=fps, at_keys=at_keys)


def load_gltf_animation(path: Path | str, animation: str | None = None) -> RigClip:
    """Returns one animation of a GLB file; the others are not read.

    Args:
        path: The file.
        animation: Its name or its caption; by default the only one.

    Raises:
        UserError: As for `load_gltf`, or there are several animations, or none has this name.
    """

    def choose(captions: Mapping[str, str]) -> list[str]:
        if animation is not None and animation in captions:  # others may have it as their caption
            return [animation]
        chosen = [title for title, caption in captions.items() if animation in (None, caption)]
        if len(chosen) != 1:
            wanted = "several animations" if animation is None or chosen else f"no animation {animation!r}"
            raise UserError(f"has {wanted}; choose one of {shorten(', '.join(captions), 200, placeholder=' ...')}")
        return chosen

    (clip,) = _load(Path(path), choose).values()
    return clip


def load_gltf_joints(path: Path | str) -> RigClip:
    """Returns the first animation of a GLB file, or its rest pose as one frame if it has none.

    Raises:
        UserError: The file cannot be read, is damaged, or has no joints.
    """
    path = Path(path)
    data = load_bytes(path)
    with reading_glb(path):
        tree = split_chunks(data).tree
        if not _titles(tree):
            return rest_clip(find_nodes(tree))
    (clip,) = _load(path, lambda captions: list(captions)[:1]).values()
    return clip


def _load(
    path: Path, choose: Callable[[Mapping[str, str]], list[str]], *, fps: float | None = None, at_keys: bool = True
) -> dict[str, RigClip]:
    """Returns the animations that a function chooses from the captions of all, by name."""
    data = load_bytes(path)
    with reading_glb(path):
        glb = split_chunks(data)
        animations = _titles(glb.tree)
        if not animations:
            raise UserError("has no animation")
        # A length of 1 has another meaning only in files of this package.
        unit = 0.01 if own_extra(glb.tree, glb.tree.get("asset", {}), "units") == "cm" else 1.0
        clips: dict[str, RigClip] = {}
        room = MAX_POSES
        owners = {str(node.get("name")) for node in glb.tree.get("nodes", [])}
        captions = {title: _caption(glb.tree, animation, title, owners) for title, animation in animations.items()}
        chosen = choose(captions)
        several = len(glb.tree.get("skins", [])) > 1  # only then, animations may move other figures
        shared = None if several else find_nodes(glb.tree)
        for title in chosen:
            animation = animations[title]
            nodes = shared or find_nodes(glb.tree, animation)
            nodes = nodes._replace(scales=nodes.scales * unit)
            with np.errstate(over="ignore", invalid="ignore"):  # what is too large is then found not to be finite
                clip = in_human_size(_sample(glb, nodes, animation, fps=fps, at_keys=at_keys, room=room))
            room -= clip.num_frames * len(nodes.names)
            clips[title] = dataclasses.replace(clip, caption=captions[title])
    return clips


def _titles(tree: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Returns animations by names, of which no two are equal. Those that move no figure are left out."""
    found: dict[str, Mapping[str, Any]] = {}
    figures = find_movers(tree)
    for number, animation in enumerate(tree.get("animations", [])):
        # Without any figure, `find_nodes` says what the file lacks.
        if not (figures & moved_nodes([animation]) if figures else animation.get("channels")):
            continue
        name = str(animation.get("name") or f"animation_{number}")
        found[free_name(name, found, "_", first=number)] = animation
    return found


def _caption(tree: Mapping[str, Any], animation: Mapping[str, Any], title: str, owners: Set[str]) -> str:
    """Returns what this package wrote about an animation, or its name without those of nodes (owners) before a `|`."""
    own = own_extra(tree, animation, "caption")
    if isinstance(own, str):
        return own
    # Blender writes "armature|action"; other text before a `|` is a part of the name.
    *before, last = title.split("|")
    return "|".join([*itertools.dropwhile(owners.__contains__, before), last])


def _own_rate(tree: Mapping[str, Any], animation: Mapping[str, Any]) -> float | None:
    """Returns the frames per second that this package wrote an animation with."""
    rate = own_extra(tree, animation, "fps")
    return float(rate) if isinstance(rate, (int, float)) and 0 < rate <= MAX_FPS else None


def _key_rate(tracks: Sequence[Float[np.ndarray, " _"]]) -> float | None:
    """Returns the frames per second of keys, None if they are uneven or too few to be the frames of a motion."""
    # Programs leave out keys on a straight line in each track by itself, so most frames are in one or another.
    for times in (np.sort(np.concatenate(tracks)), max(tracks, key=len)) if tracks else ():
        keys = times[np.diff(times, prepend=-np.inf) > SAME_TIME]
        rate = (len(keys) - 1) / max(keys[-1] - keys[0], SAME_TIME)
        for fps in (round(rate), rate):
            off = np.abs((keys - keys[0]) * fps - np.arange(len(keys)))
            if HUMANML3D.fps <= fps <= MAX_FPS and off.max() < OFF_FRAME:
                return float(fps)
    return None


def _sample(
    glb: GlbChunks, nodes: Nodes, animation: Mapping[str, Any], *, fps: float | None, at_keys: bool, room: int
) -> RigClip:
    """Returns one animation at `fps` frames per second (see `load_gltf`), if it has at most `room` poses of joints."""
    tracks: dict[tuple[int, str], _Keyframes] = {}
    for channel in animation["channels"]:
        target = channel["target"]
        sampler = animation["samplers"][channel["sampler"]]
        if target.get("node") in nodes.numbers and target["path"] in ("translation", "rotation"):
            tracks[nodes.numbers[target["node"]], target["path"]] = _read_track(glb, sampler)
    own_rate = _own_rate(glb.tree, animation)
    # A scene may begin at frame 1 or 1001, and what never changes has a single key anywhere.
    begins = [float(track.times[0]) for track in tracks.values() if len(track.times) > 1]
    begin = 0.0 if own_rate else min(begins, default=0.0)
    # Tracks may end at different times; those that end earlier keep their last value.
    seconds = max((float(track.times[-1]) for track in tracks.values()), default=begin) - begin
    if not 0 <= seconds <= MAX_SECONDS:
        raise UserError(f"an animation ends after {seconds:g} seconds; expected at most {MAX_SECONDS:g}")
    rate = fps or own_rate or (_key_rate([track.times for track in tracks.values()]) if at_keys else None)
    dense = rate or DENSE_FPS
    # The last key may be just below a whole frame.
    times = begin + np.arange(int(np.floor(seconds * dense + OFF_FRAME)) + 1) / dense
    if len(times) * len(nodes.names) > room:
        raise UserError(f"its animations have more than {MAX_POSES} poses of joints; split the file")
    translations = np.tile(nodes.translations, (len(times), 1, 1))
    rotations = np.tile(nodes.rotations, (len(times), 1, 1))
    for (joint, kind), track in tracks.items():
        (rotations if kind == "rotation" else translations)[:, joint] = _interpolate(track, times, kind)
    if not (np.isfinite(translations).all() and np.isfinite(rotations).all()):
        raise ValueError("an animation has values that are not finite")
    own = rate == own_rate is not None  # at another rate, sentences begin at other frames
    said = [own_extra(glb.tree, animation, name) if own else () for name in ("part_starts", "part_captions")]
    turned, placed = scaled_poses(nodes, rotations, translations)
    clip = dataclasses.replace(
        rest_clip(nodes),
        rotations=turned,
        translations=placed,
        fps=dense,
        parts=checked_parts(*said, num_frames=len(times)),
    )
    return clip if rate else clip.resampled(HUMANML3D.fps)


def _read_track(glb: GlbChunks, sampler: Mapping[str, Any]) -> _Keyframes:
    interpolation = sampler.get("interpolation", "LINEAR")
    times = read_accessor(glb, sampler["input"])[:, 0]
    values = read_accessor(glb, sampler["output"])
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if values.shape[1] == 4:
        values = values[:, W_FIRST]
    if not (len(times) and len(values) == per_key * len(times) and np.all(np.diff(times) >= 0)):
        raise ValueError("an animation has as many times as it has no values, or times that go back")
    return _Keyframes(times, values.reshape(len(times), per_key, -1), interpolation)


def _interpolate(track: _Keyframes, times: Float[np.ndarray, " T"], kind: str) -> Float[np.ndarray, "T C"]:
    """Returns the values at `times`; before the first key and after the last, theirs (glTF 2.0, appendix C)."""
    keys = track.times
    before = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(before + 1, len(keys) - 1)
    length = keys[after] - keys[before]
    share = np.clip(np.divide(times - keys[before], length, out=np.zeros_like(times), where=length > 0), 0, 1)
    if track.interpolation == "STEP":  # a frame at the time of a key may be just before it
        held = np.searchsorted(keys, times + SAME_TIME, side="right") - 1
        return track.values[np.maximum(held, 0), 0]
    if track.interpolation == "CUBICSPLINE":
        t = share[:, None]
        # A Hermite spline. Tangents are per second.
        return (
            (2 * t**3 - 3 * t**2 + 1) * track.values[before, 1]
            + (t**3 - 2 * t**2 + t) * (length[:, None] * track.values[before, 2])
            + (3 * t**2 - 2 * t**3) * track.values[after, 1]
            + (t**3 - t**2) * (length[:, None] * track.values[after, 0])
        )
    start = track.values[before, 0]
    end = track.values[after, 0]
    return slerp(start, end, share) if kind == "rotation" else start + (end - start) * share[:, None]
