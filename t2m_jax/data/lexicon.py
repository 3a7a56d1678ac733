"""The words that the project's own captions are made of, with parts of speech and lemmas.

The token field of a caption follows HumanML3D: hyphens removed, purely alphabetic words only, the lemma for nouns and
verbs (but "left" as it stands) and the surface form for all others, a slash and the universal part-of-speech tag.
A general tagger is a heavy dependency for a closed vocabulary, so the vocabulary is written down here.
"""

import re
from typing import NamedTuple

VERBS = (
    "act add advance aim answer approach ask back beckon begin bend block bob bolt bounce bow box bring call carry "
    "cast change chant charge come continue cover cross cut dance dash do drop end enjoy execute extend face fall "
    "fight flail follow gesture get give go greet guide hail head hit hold hop hurry indicate invite jab jog jump "
    "keep kick kneel land lead lean leap leave let lift listen look lower lunge make march move nod offer pace part "
    "pass perform place play point practice present pull pump punch push put race raise reach repeat reply respond "
    "rest retreat return reverse rise rotate run rush salute say see send shake shout show shuffle sidestep sidle "
    "sign signal slash slice spin sprint squat stand start step stop strafe straighten stretch stride strike stroll "
    "strut swagger swing take throw thrust tilt train travel tread trot try turn twirl twist usher veer volunteer "
    "walk wander wave welcome yell"
).split()
_VERBS = frozenset(VERBS)

NOUNS = (
    "squat actor adult age air anger angle answer arm attention back behind bit body bow boxer boy call care ceiling "
    "champion character chest child circle class combination confidence corner counter couple course crowd curve "
    "customer dance dancer dash degree dignity direction distance ear effort elder end energy face fan farewell "
    "fatigue feeling fight fighter figure fist floor foot friend front fun gait gang gangster gentleman gesture "
    "giant girl goodbye goodnight grandfather grandmother greeting ground guest guide guy hand head height hello "
    "hip hiphop human hurry invitation jab jog joy jump kick kid knee lady leg length line lot man manner master "
    "meter middle minute moment monster mood motion mouth movement musical name number one opponent pace pair palm "
    "passerby path pensioner performer person pivot place position posture power pride punch punk question reply "
    "respect rest reverse rhythm routine row run runner sadness samurai senior servant shoulder show shyness side "
    "signal sky slash somebody speed spin spirit sport sprint stage stance step street strength strike stroke "
    "stroll student style swagger swing sword target teacher teenager thug time tone top turn vigor visitor voice "
    "volunteer walk wave way wind woman world youngster youth"
).split()

ADJECTIVES = (
    "active aged angry athletic bad big boyish brisk calm careful casual cheerful childish clockwise confident "
    "constant counterclockwise deep different distant double dramatic elderly elegant energetic excited exhausted "
    "extended fast feminine few fierce final firm formal forward free fresh full furious gentle giant girlish "
    "gloomy good graceful happy heavy high huge insecure jogging joyful ladylike large leftward light little lively "
    "long loud macho manly many masculine merry moderate muscular musical natural nervous normal old open ordinary "
    "other outstretched own playful polite possible proud quarter quick raised rapid ready regular relaxed "
    "respectful rightward roundhouse running sad same several sharp short shy sideways single slow small smooth "
    "soft solemn spinning spirited steady stiff straight strong sudden sure tall theatrical timid tired tough "
    "typical uncertain unhappy upright upward usual vigorous walking waving weak weary whole wide worn young "
    "youthful"
).split()

ADVERBS = (
    "about actively again ahead almost along angrily anxiously anyway apart approximately around aside athletically "
    "away back backward backwards boldly bouncily briefly briskly calmly carefully casually cheerfully childishly "
    "clockwise confidently counterclockwise deeply down downward dramatically eagerly easily elegantly "
    "energetically enthusiastically exactly fast feebly fiercely finally firmly forcefully formally forth forward "
    "forwards freely furiously gently gleefully gloomily gracefully happily heavily hesitantly high hurriedly "
    "immediately instead joyfully just lazily leisurely lightly lively loudly merrily naturally nearly nervously "
    "normally not now off on once only out outward over overhead playfully politely powerfully proudly quickly "
    "quietly rapidly relaxedly respectfully roughly sadly sharply shyly sideways simply slightly slowly sluggishly "
    "smoothly softly solemnly somewhat soon steadily stiffly still straight strongly swiftly theatrically then "
    "there timidly tiredly together too twice uncertainly unhappily unhurriedly up upright upward upwards very "
    "vigorously vivaciously weakly wearily well when youthfully"
).split()

_CLOSED = {
    "DET": "a an the his her their your its this that some any each both no all my another every",
    "ADP": "above after against along around as at before behind below beside between by for from in into like near of off on "
    "onto over past through to toward towards under up upon with without",
    "PRON": "he she it they them someone somebody him anybody everyone everybody something nobody who which what",
    "CCONJ": "and or but",
    "SCONJ": "while if because until as",
    "NUM": "one two three four five ninety hundred eighty",
    "AUX": "is are has can will would be does",
    "PART": "to",
    "INTJ": "hello goodbye bye hi yes please",
}

_DOUBLED = frozenset("run jog step trot hop get put let stop cut spin begin nod hit bob jab sidestep squat".split())
_PARTICIPLES = {
    "raised": "raise", "bent": "bend", "stretched": "stretch", "turned": "turn", "held": "hold", "lifted": "lift",
    "extended": "extend", "called": "call", "clasped": "clasp", "put": "put", "seen": "see", "based": "base", "worn": "wear",
    "done": "do", "kept": "keep", "given": "give", "made": "make", "taken": "take", "thrown": "throw", "filled": "fill",
}  # fmt: skip
_IRREGULAR_NOUNS = {
    "men": "man",
    "women": "woman",
    "people": "person",
    "children": "child",
    "feet": "foot",
    "degrees": "degree",
}
_SIDES = frozenset({"left", "right"})
_NOUN_CONTEXT = frozenset({"DET", "ADJ", "NUM"})


class WordForms(NamedTuple):
    """The three forms of a verb which captions use."""

    base: str
    third: str
    gerund: str


def third_person(base: str) -> str:
    """Returns the third person singular of a regular English verb: "walk" gives "walks"."""
    if base.endswith(("s", "x", "z", "ch", "sh", "o")):
        return base + "es"
    if base.endswith("y") and base[-2] not in "aeiou":
        return base[:-1] + "ies"
    return base + "s"


def gerund(base: str) -> str:
    """Returns the -ing form: "wave" gives "waving", "run" gives "running"."""
    if base in _DOUBLED:
        return base + base[-1] + "ing"
    if base.endswith("e") and not base.endswith(("ee", "ye", "oe")):
        return base[:-1] + "ing"
    return base + "ing"


def verb_forms(base: str) -> WordForms:
    """Returns the forms of a verb of the vocabulary.

    Raises:
        KeyError: the verb is not in `VERBS`; a caption with it would have no tags.
    """
    if base not in _VERBS:
        raise KeyError(base)
    return WordForms(base, third_person(base), gerund(base))


def _make_table() -> dict[str, dict[str, str]]:
    """Returns word -> {tag: what is written for it}."""
    table: dict[str, dict[str, str]] = {}
    for base in _VERBS:
        for form in verb_forms(base):
            table.setdefault(form, {})["VERB"] = base
    for word, base in _PARTICIPLES.items():
        table.setdefault(word, {})["VERB"] = base
    for noun in NOUNS:
        table.setdefault(noun, {})["NOUN"] = noun
        table.setdefault(third_person(noun), {})["NOUN"] = noun
    for word, noun in _IRREGULAR_NOUNS.items():
        table.setdefault(word, {})["NOUN"] = noun
    for tag, words in (("ADJ", ADJECTIVES), ("ADV", ADVERBS)):
        for word in words:
            table.setdefault(word, {})[tag] = word
    for tag, text in _CLOSED.items():
        for word in text.split():
            table.setdefault(word, {})[tag] = word
    return table


_TABLE = _make_table()


def words_in(text: str) -> list[str]:
    """Returns the purely alphabetic words of a sentence, lower case, hyphens removed as HumanML3D does."""
    return [word for word in re.findall(r"[^\W_]+", text.lower().replace("-", "").replace("'", "")) if word.isalpha()]


def knows(word: str) -> bool:
    """Returns whether a lower-case word is in the vocabulary."""
    return word in _TABLE or word in _SIDES


def _guess(word: str) -> dict[str, str]:
    """Returns tags for a word outside the vocabulary, by its ending (captions that users bring)."""
    if word.endswith("ly"):
        return {"ADV": word}
    if word.endswith("ing") and len(word) > 5:
        return {"VERB": word[:-3]}
    if word.endswith("s") and not word.endswith("ss") and len(word) > 3:
        return {"NOUN": word[:-1]}
    return {"NOUN": word}


def _tag_side(previous: str, following: str) -> str:
    """Returns the tag of "left" or "right": an adjective before a noun, a noun after "the", else an adverb."""
    if "NOUN" in _TABLE.get(following, {}) and following not in ("back",) and "ADV" not in _TABLE.get(following, {}):
        return "ADJ"
    return "NOUN" if previous == "DET" else "ADV"


def _choose(readings: dict[str, str], previous: str, following: str) -> str:
    """Returns the tag for a word from its possible readings, the tag before it and the word after it."""
    if len(readings) == 1:
        return next(iter(readings))
    after = _TABLE.get(following, {})
    if "ADJ" in readings and "NOUN" in after and previous in ("DET", "ADJ", "ADP", "NUM"):
        return "ADJ"
    if previous in _NOUN_CONTEXT and "NOUN" in readings:
        return "NOUN"
    if "PART" in readings:
        return "PART" if after.get("VERB") == following else "ADP"
    if previous == "VERB" and "VERB" in readings and "ADV" in readings:
        return "ADV"
    if "DET" in readings and "NUM" not in readings:
        return "DET"
    if "ADP" in readings and ("DET" in after or "NOUN" in after or "PRON" in after):
        return "ADP"
    order = ("NUM", "VERB", "ADV", "SCONJ", "INTJ", "ADJ", "ADP", "PRON", "NOUN", "AUX")
    if previous in ("ADP", "PART") and "NOUN" in readings and "VERB" in readings:
        return "VERB" if previous == "PART" else "NOUN"
    return next(tag for tag in (*order, *readings) if tag in readings)


def tag_words(text: str, *, strict: bool = False) -> tuple[str, ...]:
    """Returns `word/TAG` for every alphabetic word of a caption, as the third field of a HumanML3D line wants it.

    Args:
        text: a caption.
        strict: refuse words outside the vocabulary in place of guessing their tag from the ending.

    Raises:
        KeyError: a word is unknown and `strict` is set.
    """
    words = words_in(text)
    tokens: list[str] = []
    previous = ""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word in _SIDES:
            previous = _tag_side(previous, following)
            tokens.append(f"{word}/{previous}")
            continue
        if strict and word not in _TABLE:
            raise KeyError(word)
        readings = _TABLE.get(word) or _guess(word)
        previous = _choose(readings, previous, following)
        tokens.append(f"{readings[previous]}/{previous}")
    return tuple(tokens)
