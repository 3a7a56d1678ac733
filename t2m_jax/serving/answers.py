"""What the HTTP interface gives: its JSON answers and the data of its events."""

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict


class SceneData(TypedDict):
    """What the viewer draws. Programs read `npz` instead."""

    seconds: float
    figures: list[dict[str, Any]]


class TargetData(TypedDict):
    """How far a motion is from a target of its request, and whether that counts as met. The unit is m or degrees."""

    name: str
    distance: float
    unit: str
    met: bool


class MotionData(TypedDict):
    """A motion with the bytes of its `.npz` file in base64."""

    caption: str
    seed: int | None
    fps: float
    frames: int
    seconds: float
    codes: list[list[int]] | None
    part_starts: list[int]
    part_captions: list[str]
    targets: list[TargetData]
    npz: str


class OpenedFile(TypedDict):
    """What `POST /scene` answers with."""

    scene: SceneData
    motion: MotionData


class ModelData(TypedDict):
    """What the model knows, and all choices and limits: `fields` has the JSON schema of each field by request.

    `file_options` has the values of each parameter of `POST /files` that only some formats have, by format.
    """

    name: str
    about: str
    license: str
    fps: float
    downsample: int
    longest_seconds: float
    joints: list[str]
    exact_joints: list[str]
    guidance_scale: float | None
    stop_rules: list[str]
    actions: list[str]
    words: list[str]
    taught: list[str]
    examples: list[str]
    file_options: dict[str, dict[str, tuple[str | bool, ...]]]
    formats_of_several: NotRequired[list[str]]
    body_bytes: NotRequired[int]
    character_bytes: NotRequired[int]
    fields: NotRequired[dict[str, dict[str, Any]]]


class HealthData(TypedDict):
    """Whether the server can generate, and how many requests wait."""

    status: Literal["ok", "restarting"]
    model: str
    waiting: int


class ErrorData(TypedDict):
    """What is wrong, in one line; and after how many seconds to try again."""

    error: str
    retry_after: NotRequired[int]


class QueuedEvent(TypedDict):
    """The request waits. It is sent again when its position changes."""

    position: int
    seed: int


class StartedEvent(TypedDict):
    """The model works on the request. If its process has died, the event comes again, and codes start anew."""

    seed: int


class CodesEvent(TypedDict):
    """Further rows of codes of a sample. `scene` has their frames, or is null while others wait.

    `share` is how much of the request is done, as far as one can tell before a motion has ended.
    """

    sample: int
    codes: list[list[int]]
    scene: SceneData | None
    share: float


class ProgressEvent(TypedDict):
    """How much is done of a request that has no codes to send before its end, from 0 to 1."""

    share: float


class WarningEvent(TypedDict):
    """A part of a sentence that the model does not know."""

    message: str


class DoneEvent(TypedDict):
    """The last event: all motions."""

    seed: int
    scene: SceneData
    motions: list[MotionData]


class FailedEvent(TypedDict):
    """The last event if there is no motion."""

    error: str
    seed: int


EVENTS = {
    "queued": QueuedEvent,
    "started": StartedEvent,
    "codes": CodesEvent,
    "progress": ProgressEvent,
    "warning": WarningEvent,
    "done": DoneEvent,
    "failed": FailedEvent,
}
"""The data of each server-sent event."""
