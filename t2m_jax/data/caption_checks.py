"""Whether captions fit the motion of their clip, where words say it plainly, and whether their text is intact."""

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from t2m_jax.data.body_checks import ClipBody
from t2m_jax.data.files import MIRROR_PREFIX
from t2m_jax.data.texts import Caption
from t2m_jax.motion.mirroring import mirror_caption

QUOTED = 60
"""Characters of a caption that a message repeats."""
MAX_OVERRUN = 0.5
"""Seconds by which a caption may end after its clip; annotators round."""
HAND_FACTOR = 3.0
"""By how much the path of one hand is longer than that of the other, if only one of them does something."""
HAND_METERS = 1.0
"""Shortest path of a hand that does something."""
TURN_DEGREES = 60.0
"""Smallest turn of a clip that is compared with captions."""
STRAIGHT_DEGREES = 20.0
"""Largest turn of a clip whose steps to a side are compared with captions."""
AHEAD_SPEED = 0.3
"""Smallest speed in meters per second, forward or backward, that is compared with captions."""
SIDE_SPEED = 0.2
"""Smallest speed in meters per second, to the left or right, that is compared with captions."""
WALK_METERS = 0.1
"""Way of a clip in its mean or fastest second whose captions tell of walking or running. In 29,000 clips it was 0.15 or
more in the mean second; if walking is a small part of a composed clip, only the fastest one tells."""
MIN_GROUP = 8
"""Clips of which the speeds of walking and other clips are compared."""
WALK_FACTOR = 1.3
"""By how much walking clips are faster than others of the data, in the median; in nine archives it was 2 to 47."""

_HAND = re.compile(
    r"\b(?:wav|rais|lift|punch|throw|swing)\w*\b(?:\W+\w+){0,3}?\W+(left|right)\W+(?:hand|arm)\b", re.IGNORECASE
)
_TURN = re.compile(r"\bturn(?:s|ing|ed)?\b(?:\W+\w+){0,3}?\W+(left|right)\b", re.IGNORECASE)
_AHEAD = re.compile(
    r"\b(?:walk|run|jog|march)(?:s|ing|ning)?\W+(?:straight\W+)?(forward|backward|back)s?\b", re.IGNORECASE
)
_SIDE = re.compile(
    r"\b(?:side-?\s?steps?|steps?|walks?|shuffles?|moves?|goes)\b(?:\W+\w+){0,2}?\W+to\W+(?:the|his|her|their|its)\W+"
    r"(left|right)\b",
    re.IGNORECASE,
)
_WALK = re.compile(r"\b(?:walk|run|jog|march|stride|striding|sprint|dash|stroll)(?:s|ing|ning)?\b", re.IGNORECASE)
# In such sentences, a word about a side may be about another part of the motion, and walking may be on the spot.
_SEQUENCE = re.compile(
    r"\b(?:then|followed|next|first|before|after\w*|finally|and|while|as|same time)\b|,", re.IGNORECASE
)
_BOTH_WAYS = re.compile(r"\bforwards?\b.*\bback|\bback(?:wards?)?\b.*\b(?:forward|ahead)", re.IGNORECASE)
_IN_PLACE = re.compile(r"\b(?:in place|on the spot|treadmill|stationary)\b", re.IGNORECASE)
_NOT_YET = re.compile(r"\b(?:st[oa]\w*|begin\w*)\b", re.IGNORECASE)
"""Starts, stops, stands, begins."""
_FOREIGN = re.compile(r"[^\x00-\x7f]+")


def check_captions(captions: Iterable[Caption], *, seconds: float) -> list[str]:
    """Returns the faults of the captions of one clip that lasts `seconds`."""
    captions = tuple(captions)
    problems = [] if captions else ["has no caption"]
    for caption in captions:
        quoted = _quote(caption.text)
        if not caption.tokens:
            problems.append(f"{quoted} has no word/POS tokens")
        # An evaluator splits tokens at their only slash.
        elif any(token.count("/") != 1 or not all(token.split("/")) for token in caption.tokens):
            problems.append(f"{quoted} has a token that is not word/POS")
        if not 0.0 <= caption.start <= caption.end:
            problems.append(f"{quoted} has times {caption.start} to {caption.end}")
        elif caption.end > seconds + MAX_OVERRUN:
            problems.append(f"{quoted} ends at {caption.end} s, the clip at {seconds:.2f} s")
        if is_misread(caption.text):
            problems.append(f"{quoted} is UTF-8 that was read in another encoding")
    return problems


def _quote(text: str) -> str:
    return f"caption '{text[:QUOTED]}{'...' * (len(text) > QUOTED)}'"


def is_misread(text: str) -> bool:
    """Returns whether a text has characters that are made of the bytes of another one, or marks of lost ones."""
    if "\ufffd" in text:
        return True
    for part in _FOREIGN.findall(text):
        for encoding in ("latin-1", "cp1252"):
            try:
                part.encode(encoding).decode()
            except UnicodeError:
                continue
            return True
    return False


def check_words(captions: Iterable[Caption], body: ClipBody) -> list[str]:
    """Returns where all captions about a clip that name a side or a direction name the other one."""
    whole = [caption.text for caption in captions if caption.whole_clip]
    texts = [text for text in whole if not _SEQUENCE.search(text)]
    problems = []
    left, right = body.hands
    hand = "left" if left > right else "right"
    if max(left, right) > max(HAND_METERS, HAND_FACTOR * min(left, right)) and _only(_HAND, texts) not in (None, hand):
        problems.append(f"tells of the other hand; the {hand} one moves")
    turn = "left" if body.turn > 0 else "right"
    if abs(body.turn) > TURN_DEGREES and _only(_TURN, texts) not in (None, turn):
        problems.append(f"tells of a turn to the other side; the clip turns to the {turn}")
    side = "left" if body.left > 0 else "right"
    is_straight = abs(body.turn) < STRAIGHT_DEGREES and abs(body.left) > SIDE_SPEED
    if is_straight and _only(_SIDE, texts) not in (None, side):
        problems.append(f"tells of steps to the other side; the clip moves to the {side}")
    way = "forward" if body.ahead > 0 else "back"
    texts = [text for text in texts if not _BOTH_WAYS.search(text)]
    if abs(body.ahead) > AHEAD_SPEED and (_only(_AHEAD, texts) or way)[:4] != way[:4]:
        problems.append(f"tells of the other direction; the clip moves {way} (or time is reversed)")
    if max(body.speed, body.fastest) < WALK_METERS and _tells_of_walking(whole):
        problems.append("tells of walking or running, but the clip stays where it is")
    return problems


def _only(pattern: re.Pattern[str], texts: Sequence[str]) -> str | None:
    """Returns the one word that texts have at a place, None if there is none or if it is not the only one."""
    found = {word.lower() for text in texts for word in pattern.findall(text)}
    return found.pop() if len(found) == 1 else None


def _tells_of_walking(texts: Sequence[str]) -> bool:
    told = sum(bool(_WALK.search(text)) and not _NOT_YET.search(text) for text in texts)
    return 2 * told >= max(len(texts), 1) and not any(_IN_PLACE.search(text) for text in texts)


def check_speeds(captions: Mapping[str, Sequence[Caption]], bodies: Mapping[str, ClipBody]) -> list[str]:
    """Returns whether clips whose captions tell of walking or running are no faster than the others, over all clips."""
    walking, others = [], []
    for name, body in bodies.items():
        texts = [caption.text for caption in captions.get(name, ()) if caption.whole_clip]
        told = [bool(_WALK.search(text)) for text in texts]
        if told and 2 * sum(told) >= len(told):
            walking.append(body.speed)
        elif told and not any(told):
            others.append(body.speed)
    if min(len(walking), len(others)) < MIN_GROUP:
        return []
    medians = float(np.median(walking)), float(np.median(others))
    if medians[0] > WALK_FACTOR * medians[1]:
        return []
    return [
        f"texts: clips of walking and running move at {medians[0]:.2f} m/s, others at {medians[1]:.2f} m/s; captions "
        "belong to other clips"
    ]


def check_twin_captions(name: str, captions: Mapping[str, Sequence[Caption]]) -> list[str]:
    """Returns whether the captions of a mirrored twin tell of the same sides as those of its original."""
    mine = {caption.text for caption in captions.get(name, ())}
    others = {caption.text for caption in captions.get(name.removeprefix(MIRROR_PREFIX), ())}
    same = sorted(text for text in mine & others if mirror_caption(text) not in (text, *others))
    return [f"{_quote(same[0])} is that of the original; in a twin, left and right are exchanged"] if same else []
