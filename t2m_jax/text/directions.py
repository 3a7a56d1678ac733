"""Directions that people leave out, in words that captions have: "she returns" is read as "she walks forward".

Captions name the gait and the direction of who goes somewhere, and the side of a turn. People often name neither, and
their "back" and "away" mean where to, not which way somebody faces. Who only turns or goes to a side walks around a
corner. The verbs are those of Levin, English Verb Classes and Alternations (1993), sections 51.1 and 51.3.2, and a few
more, without those of motions that are no gait, such as climbing.
"""

import re
from collections.abc import Collection

from t2m_jax.text.numerals import ABOUT, pattern
from t2m_jax.text.subjects import THINGS
from t2m_jax.text.verbs import (
    BEFORE_BASE_FORM,
    BODY,
    BODY_PARTS,
    CLAUSE_STARTS,
    DETERMINERS,
    LIGHT_VERBS,
    PREPOSITIONS,
    bases_of,
    form_of,
    forms,
    inflected,
    is_negated,
    readings,
    word_set,
    words_of,
)

_WALKS = word_set(
    """amble backpack barge canter coast creep dodder drift file flit frolic gambol glide hike hobble inch journey limp
    lollop lumber lurch march meander mince mosey pace pad parade patrol perambulate plod prance promenade prowl ramble
    roam rove sashay saunter shamble shuffle skulk sleepwalk slink slog slouch sneak stagger stalk stomp storm stray
    stride stroll strut stumble swagger tiptoe toddle totter traipse tramp travel trek troop trudge trundle waddle wade
    walk wander"""
)
_RUNS = word_set(
    """bolt charge dart dash hasten hurry hurtle jog lope race run rush scamper scoot scramble scud scurry scutter
    scuttle skedaddle skitter speed sprint streak tear trot whiz zoom"""
)
_GOES = word_set("come go head move nip pass pop proceed step")
"""Verbs that say with a way that somebody walks, and without one something else: "comes to life", "moves the arms"."""
_ARRIVES = {
    "advance": "",
    "arrive": "",
    "depart": "",
    "enter": "into",
    "exit": "out of",
    "leave": "out of",
    "return": "",
}
"""Verbs that need no way, and what "walks" needs before their object."""
_COVERS = {"approach": "to", "cross": "across", "traverse": "across"}
"""Verbs that need an object, and what "walks" needs before it."""
_OBJECTS = _ARRIVES | _COVERS
_TRAVELS = _WALKS | _RUNS | _GOES | _OBJECTS.keys()

_OWN = "(?:his|her|their|its|your|my)"
_A = rf"(?:(?:a|an|the|some|this|that|another|{_OWN})\b|\w+'s\b)"
_NO_GOAL = (
    rf"(?:\w+ing|{_OWN} (?:feet|knees|senses|side)|(?:a |an |the |one )?(?:attention|beat|end(?! of)|floor|ground|halt|"
    r"life|music|pieces|rest|rhythm|side|sleep|stand|stop))\b"
)
"""What is no place: "goes to sleep", "moves to the beat", "goes back to stretching"."""
_GOAL = rf"to (?!{_NO_GOAL})"
_THROUGH = "(?:across|along|behind|down|inside|out|outside|over|past|through|up)"
_WAY = pattern(
    r"(?: all the way| forward| just| straight|,? \w+ly)* (?:",
    rf"(?:into|onto|out of|toward|towards)\b|{_GOAL}|{_THROUGH} {_A}|(?:closer|here|home|on stage)\b|",
    rf"(?:away|off)(?! {_A})|(?:along|back|down|in|out|over|up) from\b|",
    rf"(?:along|back|down|in|on|out|over|up) (?:{_GOAL}|(?:{_THROUGH}|here|home|into|onto|the way|there|towards?)\b)|",
    r"(?:back|elsewhere|in|indoors|inside|out|outdoors|outside|somewhere(?: else)?)(?=$|[.,;!?]))",
)
"""What says behind a verb where somebody goes."""
_END = pattern(r"(?: \w+ly)*(?=$|[.,;!?]| (?:at|for|from)\b)")
_OBJECT = pattern(rf" {_A}(?! (?:ankles?|arms?|fingers?|hands?|legs?|wrists?)\b)")
_IS_LEFT_THERE = pattern(r".* (?:alone|at|behind|in|on|open)\b")
"""What follows a thing that somebody leaves somewhere."""
_SMALL = word_set("move step")
_ASIDE = pattern(r" (?:away|back|down|off|on|onto|over (?!to)|up(?! to))\b")
"""What says of the verbs of `_SMALL` that somebody goes backward, or not far."""
_IDIOM = pattern(
    rf"\b(?P<way>(?:find|mak|pick|push|work)\w*|found|made) {_OWN} way\b|",
    r"\b(?P<off>sets?|setting) (?:off|out)(?= (?:across|along|down|for|into|through|to|towards?|up)\b|$|[.,;!?])|",
    rf"\b(?P<to>head\w*|mak\w+|made) for(?= {_A})",
)
"""Other words for "go", "go off" and "go to"."""
_OTHERWISE = pattern(
    r"\b(?:around|aside|back and forth|backing|backs|backwards?|circles?|code|crab\w*|diagonal\w*|downhill|downstairs|",
    r"eyes|facing|hill|ladder|lateral\w*|left|look\w* back|number|password|place|pose|position|posture|ramp|recoil\w*|",
    r"retreat\w*|reverse|right|side[ -]?(?:on|shuffl\w+|ste\w+)|sideways?|slope|spot|staircase|stairs?|stance|",
    rf"(?:go|goes|going|went) through {_OWN}|standing|strafe\w*|strafing|to and fro|treadmill|",
    r"turn\w*|up and down|uphill|upright|upstairs|watching|",
    rf"(?:{_OWN}|the) back(?! (?:door|of|room|yard)\b)|back first)\b",
)
"""Words of other directions and paths, of poses, and of what is entered with keys."""
_FORWARD = pattern(r"\b(?:ahead|forwards?|onwards?|straight)\b")
_NOT_LEARNED = pattern(r"^((?: all the way| just|,? \w+ly)*) (?:away(?! from)|back|off|over(?= to))(?= |$|[.,;!?])")
"""Words of a way that captions have for something else."""
_AT = pattern(r"^((?: \w+ly)*) at\b")
_HALF = r"(?:180|one[- ]eighty|(?:a|one) hundred (?:and )?eighty)(?: ?\u00b0|[- ]degrees?)?"
_NEARLY = rf"(?:(?:{'|'.join(ABOUT)}) )?"
_ANGLE = r"(?: (?!and\b)[\w.,-]+){1,5}?(?: ?\u00b0| ?degrees?\b|-degrees?\b)"
_AROUND = r"(?:(?:\w+ly|right|half ?way) )?(?:a?round|about)"
_BACK = (
    r"(?:to \w+ )?(?:(?:what|who|whoever) (?:is|was) )?(?:backwards?|behind(?: \w+)?|"
    r"(?:in |to )?the (?:other|opposite) (?:direction|side|way))"
)
_TURNS = (
    r"(?:pivot(?:t?ed|t?ing)?|rotat(?:e|ed|ing)|swivel(?:l?ed|l?ing)?|turn(?:ed|ing)?|wheel(?:ed|ing)?|whip(?:ped|ping)?|"
    r"whirl(?:ed|ing)?)s?"
)
_TURN = pattern(
    rf"\b(?:(?P<turn>{_TURNS}) (?:(?:{_AROUND} )?{_BACK}|",
    rf"(?:{_AROUND} )?(?:by )?{_NEARLY}(?:{_HALF}|a half turn)|{_AROUND}|",
    rf"{_OWN} back (?:on|to) \w+)|(?P<spin>spins?|spinning|spun) {_AROUND} to \w+(?: {_BACK})?|",
    r"(?P<does>(?:do|execut|mak|perform)\w*|did|made) (?:an?|half an?)(?: \w+)? ",
    rf"(?:about[ -](?:face|turn)|half[ -](?:rotation|turn)|{_HALF}(?: turn)?))",
    rf"(?![\w-]| (?:{_A}|and (?:a?round|about)\b)|{_ANGLE})",
)
"""A turn by half a circle. "Turns around the corner" is a path, and "turns about 90 degrees" another turn."""
_TURNS_AROUND = "a person turns around to the right on the spot"
_STILL = word_set("stand stay stop talk tell wait")
"""What somebody may do who turns around, without another motion."""
_SIDE = pattern(r"\b(?:\w*clockwise|circles?|corner|left(?:wards?)?|right(?:wards?)?(?! a?round)|times|twice)\b")
_ON_THE_SPOT = pattern(r"\b(?:in place|on the spot)\b")
_HOW = r"(?: (?!diagonal|lateral)\w+ly| again| a (?:bit|little))*"
_TO_SIDE = (
    rf"(?:(?:to|towards?|in the direction of) (?:(?:the|{_OWN}) )?(?:left|right)(?:(?:[ -]hand)? (?:direction|side))?|"
    r"(?:left|right)(?:wards?)?)"
    rf"{_HOW}[.!]*"
)
_CIRCLES = word_set("complete entire full half quarter whole")
"""Of a turn: it is on the spot."""
_KIND = rf"(?:(?!{'|'.join(_CIRCLES)})[a-z]+ )?"
_A_CORNER = rf"(?:an?|the next) {_KIND}(?:(?:left|right)(?:[ -]hand)?(?: turn)?{_HOW}[.!]*|turn{_HOW} {_TO_SIDE})"
_ONLY_TO_SIDE = pattern(
    rf"(?P<before>.*?)(?<![\w-])(?P<verb>\w+)(?P<way>(?: off)?{_HOW} {_TO_SIDE}| {_A_CORNER})",
)
_WITHOUT_VERB = pattern(
    rf"(?:an? )?(?P<turn>{_KIND}(?:left|right)[ -]turn[.!]*|(?<=[an] ){_KIND}turn{_HOW} {_TO_SIDE})",
)
"""The same as a noun: "a slow turn to the left"."""
_TURNS_OR_GOES = _WALKS | _RUNS | word_set("curve do execute go hang head hook make perform swerve take turn veer")
"""Verbs that say with a side that somebody turns, or goes to that side."""
_STAYS = word_set("crouch kneel lie lay seat sit squat stand stay")
_NO_SUBJECT = (_STAYS | _CIRCLES | BODY | CLAUSE_STARTS | PREPOSITIONS | THINGS) - BEFORE_BASE_FORM
"""Words before the verb of who does not walk: "the seated man turns left", "her head turns left"."""
_WORD = re.compile(r"(?<![\w'-])[^\W\d_]+(?![\w'-])")


def with_directions(prompt: str, known: Collection[str], actions: Collection[str] = ()) -> tuple[str, dict[str, str]]:
    """Returns a sentence with the directions that it leaves out, and which gaits were read as walking or running.

    Who goes somewhere goes forward, and who turns around does so on the spot and to the right; if that is the only
    action, nothing else of the sentence is kept. Who only turns or goes to a side walks forward and turns. Other
    sentences, and those that name a direction, stay as they are.

    Args:
        prompt: A checked sentence.
        known: Words that captions have. Other gaits are read as walking or running.
        actions: Of the model; empty if it has no record of them.
    """
    turn = find_turn(prompt)
    if turn is not None:
        others = words_of(f"{prompt[: turn.start()]}, {prompt[turn.end() :]}")
        # "So that she sees who is there" or "while standing" would turn her less.
        if actions and _STILL.issuperset(word.action for word in others if word.action in actions):
            return _TURNS_AROUND, {}
        verb = _in_form_of(turn[turn.lastgroup or 0], "turn")
        spot = "" if _ON_THE_SPOT.search(prompt) else " on the spot"
        return f"{prompt[: turn.start()]}{verb} around to the right{spot}{prompt[turn.end() :]}", {}
    if (noun := _WITHOUT_VERB.fullmatch(prompt)) is not None:
        return f"a person walks forward and makes a {noun['turn']}", {}
    corner = _find_corner(prompt)
    if corner is not None:
        return _with_corner(corner, known)
    text = _IDIOM.sub(_as_go, prompt)
    travel = None if _OTHERWISE.search(text) else _find_travel(text)
    return (prompt, {}) if travel is None else _with_way(text, *travel, known)


def find_turn(sentence: str) -> re.Match[str] | None:
    """Returns where a sentence says that somebody turns around, to no side and without going anywhere, if it does."""
    found = _TURN.search(sentence)
    if found is None or _SIDE.search(sentence):
        return None
    before = words_of(sentence[: found.start()])
    others = [*before, *words_of(sentence[found.end() :])]
    # "The wheel turns" is no verb; who turns while walking goes around a corner.
    is_noun = before and before[-1].text in DETERMINERS
    is_other = is_noun or is_negated(before) or any(not _TRAVELS.isdisjoint(word.bases) for word in others)
    return None if is_other else found


def only_turns_to_side(sentence: str) -> bool:
    """Returns whether all that a sentence says is that somebody turns to a side: "she slowly turns left"."""
    corner = _find_corner(sentence)
    turns = corner is not None and not _travel_base(corner["verb"].lower())
    return turns or _WITHOUT_VERB.fullmatch(sentence) is not None


def goes_somewhere(sentence: str, *, at_once: bool = False) -> bool:
    """Returns whether somebody goes to a place that a sentence names: "walks in", "returns", but not "walks".

    With `at_once`, its first word must be the verb.
    """
    travel = _find_travel(_IDIOM.sub(_as_go, sentence))
    return travel is not None and not (at_once and travel[0].start())


def _find_corner(sentence: str) -> re.Match[str] | None:
    """Returns the parts of a sentence in which somebody turns or goes to a side, and does nothing else."""
    found = _ONLY_TO_SIDE.fullmatch(sentence)
    if found is None or _TURNS_OR_GOES.isdisjoint(forms(found["verb"].lower())):
        return None
    before = words_of(sentence)[: len(words_of(found["before"]))]
    does_more = any(word.action not in LIGHT_VERBS | {""} for word in before)
    is_other = does_more or is_negated(before) or not _NO_SUBJECT.isdisjoint(bases_of(before))
    return None if is_other or _OTHERWISE.search(found["before"]) else found


def _with_corner(found: re.Match[str], known: Collection[str]) -> tuple[str, dict[str, str]]:
    """Returns the sentence of `_find_corner` as a walk, and which gait was read as another."""
    verb = found["verb"].lower()
    going = _travel_base(verb)
    gait, read = _known_gait(found["verb"], going, known)
    turns = _in_form_of(verb, "turn") if going else verb
    return f"{found['before']}{gait} forward and {turns}{found['way']}", read


def _find_travel(text: str) -> tuple[re.Match[str], str] | None:
    """Returns the verb of somebody who goes somewhere, and its basic form."""
    for found in _WORD.finditer(text):
        verb = _travel_verb(found[0].lower(), text[: found.start()], text[found.end() :])
        if verb:
            return found, verb
    return None


def _with_way(text: str, found: re.Match[str], verb: str, known: Collection[str]) -> tuple[str, dict[str, str]]:
    after = text[found.end() :]
    said, read = _known_gait(found[0], verb, known)
    forward = "" if _FORWARD.search(text) else " forward"
    into = f" {_OBJECTS[verb]}" if _OBJECTS.get(verb) and _OBJECT.match(after) else ""
    # "Arrives at the gate".
    way = _NOT_LEARNED.sub(r"\1", _AT.sub(r"\1 to", after) if verb in _ARRIVES else after)
    return f"{text[: found.start()]}{said}{forward}{into}{way}", read


def _known_gait(word: str, verb: str, known: Collection[str]) -> tuple[str, dict[str, str]]:
    """Returns a gait of captions in the form of a word, and whether it was another gait; `verb` is its basic form."""
    is_gait = verb in _WALKS | _RUNS
    said = word if is_gait and verb in known else _in_form_of(word, "run" if verb in _RUNS else "walk")
    return said, {word: said} if is_gait and said != word else {}


def _travel_base(word: str) -> str:
    """Returns the basic form of a verb of somebody who goes; an empty text for another word."""
    return next((base for base in readings(word).get("VERB", ()) if base in _TRAVELS), "")


def _travel_verb(word: str, before: str, after: str) -> str:
    """Returns the basic form of a word if it is the verb of somebody who goes somewhere; otherwise an empty text."""
    verb = _travel_base(word)
    if not verb or not _says_way(verb, after):
        return ""
    words = words_of(before)
    is_noun = words and words[-1].text in DETERMINERS | PREPOSITIONS
    # In "waves as he leaves" and "the arms go up", it is not what the person does.
    is_beside = any(word.action not in LIGHT_VERBS | {""} and word.text not in BEFORE_BASE_FORM for word in words)
    is_part = any(not BODY_PARTS.isdisjoint(word.bases) for word in words)
    return "" if is_noun or is_beside or is_part or is_negated(words) else verb


def _says_way(verb: str, after: str) -> bool:
    """Returns whether the words behind a verb of travel say that somebody goes somewhere."""
    if verb in _COVERS:
        return _OBJECT.match(after) is not None
    if verb in _SMALL and _ASIDE.match(after):
        return False
    has_object = _ARRIVES.get(verb) and _OBJECT.match(after) and not (verb == "leave" and _IS_LEFT_THERE.match(after))
    return bool(has_object or _WAY.match(after) or (verb in _ARRIVES and _END.match(after)))


def _as_go(found: re.Match[str]) -> str:
    """Returns "go" in the form of the verb of an idiom."""
    kind = found.lastgroup or ""
    return _in_form_of(found[kind], "go") + ("" if kind == "way" else f" {kind}")


def _in_form_of(word: str, verb: str) -> str:
    """Returns a verb in the form of another one."""
    return inflected(verb, form_of(word))
