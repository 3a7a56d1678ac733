"""What the HTTP interface takes: pydantic models, made from the records of the library, with limits."""

import base64
import binascii
import dataclasses
import difflib
import re
import reprlib
import secrets
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    WithJsonSchema,
    create_model,
)

from t2m_jax.errors import UserError
from t2m_jax.export.render.view import Camera
from t2m_jax.motion.bvh.writer import Units
from t2m_jax.motion.changes import Changes, path_from_text
from t2m_jax.motion.formats import SINGLE, motion_formats
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.paths import LARGEST_TURN
from t2m_jax.motion.resampling import MAX_SPEED
from t2m_jax.motion.rig.rigs import JointNames
from t2m_jax.motion.targets import Target, targets_from_text
from t2m_jax.records import fields_of, record_from
from t2m_jax.sampling.prompts import MAX_BATCH
from t2m_jax.sampling.request import MotionRequest

MAX_TOTAL_SECONDS = 600.0
"""Of all samples of a request, if it says how long they are, and of a file."""
MAX_BODY = 16 * 2**20
"""Bytes of a request: a motion of ten minutes."""
MAX_CHARACTER = 32 * 2**20
"""Bytes of a character, which has textures."""
MAX_CHARACTER_BODY = MAX_CHARACTER * 4 // 3 + 4 * 2**20
"""Bytes of a request with one, in base64, and motions."""
MAX_JSON = 2**16
"""Bytes of a JSON body without the motions in it. Sentences need a third of it."""
MAX_MOTIONS = 32
"""Motions in one file."""
LIMITS: Mapping[str, Mapping[str, Any]] = {
    # Tighter than those of the library, so that no user takes the server from the others.
    "captions": {"min_length": 1, "max_length": 20},
    "num_samples": {"ge": 1, "le": 8},
    "seconds": {"gt": 0, "le": 60.0},
    "guidance_scale": {"ge": 0, "le": 20.0},
    "fps": {"ge": 1, "le": 120, "multiple_of": 1},
    # Each set of these three is a program that must be compiled, so they have few values.
    "temperature": {"ge": 0, "le": 2.0, "multiple_of": 0.1},
    "top_k": {"ge": 10, "le": 100, "multiple_of": 10},
    "top_p": {"ge": 0.1, "le": 1.0, "multiple_of": 0.1},
    # Those of the library, for those who read the description.
    "seed": {"ge": 0, "le": 2**32 - 1},
    "candidates": {"ge": 1, "le": MAX_BATCH},
    "strength": {"ge": 0, "le": 1},
    "begin": {"ge": 0},
    "speed": {"ge": 1 / MAX_SPEED, "le": MAX_SPEED},
    "turn": {"ge": -LARGEST_TURN, "le": LARGEST_TURN},
}
"""What is refused beyond the types of the fields, in pydantic's words."""
PYTHON_ONLY = ("strategy", "max_codes")
"""Fields that HTTP does not have: an object of Python, and a length of which each is a program of its own."""
SEVERAL = tuple(name for name in motion_formats() if name not in SINGLE)
"""Formats that can contain several motions."""
BASE64_LETTERS = b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+/="
InputFormat = Literal["npz", "bvh", "glb", "vrma", "npy"]


def decode_base64(text: object) -> bytes:
    """Returns the bytes of a text in base64.

    Raises:
        ValueError: It is not base64.
    """
    try:
        return base64.b64decode(text, validate=True)  # type: ignore[arg-type]
    except (binascii.Error, ValueError, TypeError):
        raise ValueError("is not base64") from None


Base64 = Annotated[
    bytes, PlainValidator(decode_base64), WithJsonSchema({"type": "string", "contentEncoding": "base64"})
]
PathText = Annotated[
    tuple[tuple[float, float], ...], PlainValidator(path_from_text), WithJsonSchema({"type": "string"})
]


def _targets(value: object) -> tuple[Target, ...]:
    if not isinstance(value, str):
        raise ValueError("is not one text with all targets")
    return targets_from_text(value)


def _whole(value: object) -> object:
    """Returns a whole number as an integer: in JSON, 1.0 is one, too."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


TargetsText = Annotated[tuple[Target, ...], PlainValidator(_targets), WithJsonSchema({"type": "string"})]
Replacement = tuple[Any, Any, str]
"""A type, a default and a text."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FileOptions:
    """From `POST /files` to the process that writes the file."""

    format: str = "npz"
    """Format of the file."""
    names: JointNames | None = None
    """Names of the joints in BVH and GLB files. With `smpl`, NPZ files have the layout of AMASS."""
    units: Units | None = None
    """Units of BVH and GLB files."""
    root_bone: bool = False
    """Whether BVH and GLB files have a bone on the floor that carries the travel."""
    camera: Camera | None = None
    """Whether the camera of GIF and MP4 files only follows, or also goes around the figures once."""
    changes: Changes = Changes()
    """What is changed before."""


def make_model(name: str, record: type, replaced: Mapping[str, Replacement]) -> type[BaseModel]:
    """Returns a model with the fields of a record, but for those that HTTP has in another way, or not at all.

    Unknown fields are refused, and numbers must be finite.
    """
    fields = {field.name: (field.annotation, field.default, field.text) for field in fields_of(record)}
    fields.update(replaced)
    annotated: dict[str, Any] = {
        name: (
            # Outside of the limits, so that they are those of the integer.
            Annotated[annotation, BeforeValidator(_whole)] if annotation in (int, int | None) else annotation,
            Field(... if default is dataclasses.MISSING else default, description=text, **LIMITS.get(name, {})),
        )
        for name, (annotation, default, text) in fields.items()
        if name not in PYTHON_ONLY
    }
    return create_model(name, __config__=ConfigDict(extra="forbid", allow_inf_nan=False), **annotated)


_PATH: Replacement = (PathText | None, None, 'Points on the ground to walk through, such as "0,0 1,2 3,2"; meters.')
MotionBody = make_model(
    "MotionBody",
    MotionRequest,
    {
        "seed": (int | None, None, "From 0 to 2**32 - 1; by default a random one."),
        "start": (Base64 | None, None, "A motion to continue. With `span` or `strength`, it is changed instead."),
        "start_format": (InputFormat, "npz", "Format of `start`."),
        "targets": (
            TargetsText | None,
            None,
            'Where joints should be at a time, such as "2 right_wrist=-0.3,1.7,0.2; 4 root=1,3"; seconds and meters.',
        ),
    },
)
_READ_AS: dict[str, Replacement] = {
    "path": _PATH,
    "rig": (str | None, None, "Name of the file's rig, or the text of a table. By default, joints are recognized."),
    "name": (str | None, None, "What the file is called in errors."),
    "rig_name": (str | None, None, "What the table in `rig` is called in errors."),
}
"""What is said of a file of a figure that is read."""
FileParameters = make_model(
    "FileParameters", FileOptions, {"format": (Literal[motion_formats()], "npz", "Format of the file."), "path": _PATH}
)
SceneParameters = make_model(
    "SceneParameters",
    Changes,
    {
        "format": (InputFormat, "npz", "Format of the body."),
        **_READ_AS,
        "split": (float | None, None, "Seconds at which a sentence of the changed motion becomes two."),
    },
)
CharacterParameters = make_model("CharacterParameters", Changes, _READ_AS)


class KeepParameters(BaseModel):
    """The parameters of `POST /motions`."""

    model_config = ConfigDict(extra="forbid")
    keep: str | None = Field(
        None,
        description="A random key of 16 to 64 letters, digits, - and _. The request then goes on without a connection, "
        "and `/motions/{key}` has its answer up to ten minutes after its end.",
    )


class FileBody(BaseModel):
    """The body of `POST /files` for several motions."""

    model_config = ConfigDict(extra="forbid")
    motions: list[Base64] = Field(min_length=1, max_length=MAX_MOTIONS, description="`.npz` files.")


class CharacterBody(FileBody):
    """The body of `POST /character`."""

    character: Base64 = Field(description="A `.glb` or `.vrm` file with a skin.")


def read_body(model: type[BaseModel], body: bytes) -> dict[str, Any]:
    """Returns the fields in a JSON body.

    Raises:
        UserError: It is not JSON, or a field is unknown, missing or has a value that cannot be used.
    """
    _check_size(body)
    try:
        # Strict, so that `true` is no number and 1.5 no seed.
        return _given(model.model_validate_json(body, strict=True))
    except ValidationError as error:
        raise _explained(error, model, "request") from None


def _check_size(body: bytes) -> None:
    """Raises `UserError` if a body is large without its motions: its items would be made before they are counted."""
    if len(body) <= MAX_JSON:
        return
    # Motions are texts in base64 of more than 1000 bytes. Other parts between quotes may be a million numbers.
    parts = body.split(b'"', MAX_JSON)
    motions = [part for part in parts if len(part) > 1000 and not part.translate(None, BASE64_LETTERS)]
    if len(body) - sum(map(len, motions)) > MAX_JSON:
        raise UserError(f"request: has more than {MAX_JSON:,} bytes without the motions in it")


def read_parameters(model: type[BaseModel], query: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Returns the fields in the parameters of an address, which are pairs of a name and a value.

    Raises:
        UserError: A parameter is unknown, is there twice, or has a value that cannot be used.
    """
    pairs = list(query)
    for name, count in Counter(name for name, _ in pairs).items():
        if count > 1:
            raise UserError(f"parameters: {name[:100]}: is given {count} times; give it once")
    try:
        # In an address, all values are texts.
        return _given(model.model_validate_strings(dict(pairs)))
    except ValidationError as error:
        raise _explained(error, model, "parameters") from None


def _given(found: BaseModel) -> dict[str, Any]:
    """Returns the fields that a user has given; the others have the defaults of the records."""
    return {name: getattr(found, name) for name in found.model_fields_set}


def _explained(error: ValidationError, model: type[BaseModel], source: str) -> UserError:
    """Returns the first problem in one line that names the field and its value."""
    first = error.errors()[0]
    kind = first["type"]
    name = ".".join(map(str, first["loc"]))
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(name, model.model_fields, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(model.model_fields)}"
        return UserError(f"{source}: unknown field '{name[:100]}'; {hint}")
    if kind == "value_error":  # of a function of ours, which may name the field
        return UserError(f"{source}: {name}: {str(first['ctx']['error']).removeprefix(f'{name}: ')}")
    # "Tuple should have at most 2 items after validation, not 3": there are no tuples in JSON.
    text = re.sub(r"^(Tuple|List) (.*) after validation", r"Input \2", first["msg"])
    reason = text[0].lower() + text[1:]
    says_value = kind in ("missing", "json_invalid", "model_type", "too_short", "too_long")
    value = "" if says_value else f", not {reprlib.repr(first['input'])}"
    return UserError(": ".join(filter(None, (source, name, reason))) + value)


def motion_request(fields: Mapping[str, Any], start: Motion | None) -> MotionRequest:
    """Returns the request of a `MotionBody`, with a random seed if there is none.

    Args:
        fields: The fields of the body.
        start: The motion in `start`.

    Raises:
        UserError: Fields do not go together.
    """
    if start is None and "start_format" in fields:
        raise UserError("start_format: is the format of start; give start, or leave it out")
    values = dict(fields) | {"start": start, "targets": fields.get("targets") or ()}
    # JSON may say 0.7 as 0.7000000000000001, which would be a program of its own.
    values |= {name: round(fields[name], 2) for name in ("temperature", "top_p") if fields.get(name) is not None}
    if fields.get("seed") is None:
        values["seed"] = secrets.randbelow(2**32)
    return record_from(MotionRequest, values)


def check_lengths(request: MotionRequest) -> None:
    """Raises `UserError` if a request asks for more seconds than the server makes, in a field or in its sentences."""
    lengths = [seconds for seconds in request.lengths if seconds is not None]
    longest = LIMITS["seconds"]["le"]
    if max(lengths, default=0) > longest:
        raise UserError(f"seconds: {max(lengths):g} for a sentence are more than {longest:g}")
    # With room for rounding: the length of a sentence may have been divided among its actions.
    if sum(lengths) * request.num_samples > MAX_TOTAL_SECONDS + 1e-6:
        raise UserError(f"seconds: all motions together would be longer than {MAX_TOTAL_SECONDS:g} seconds")
