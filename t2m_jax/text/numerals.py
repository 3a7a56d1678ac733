"""Numbers in sentences: in digits, in words, and ranges of them ("two or three")."""

import re

_ONES = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_TEENS = """ten eleven twelve thirteen fourteen fifteen sixteen seventeen eighteen nineteen"""
_TENS = ("twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety")
_TO_HUNDRED = [*_ONES, *_TEENS.split(), *(f"{tens} {one}".strip() for tens in _TENS for one in ("", *_ONES))]
_VALUES = {word: float(number) for number, word in enumerate(_TO_HUNDRED, 1)} | {
    "a hundred": 100.0,
    "one hundred": 100.0,
    "a couple of": 2.0,
    "a couple": 2.0,
    "half a dozen": 6.0,
    "a dozen": 12.0,
    "half an": 0.5,
    "half a": 0.5,
    "a quarter of a": 0.25,
    "once": 1.0,
    "twice": 2.0,
    "thrice": 3.0,
    "a single": 1.0,
    "a double": 2.0,
    "a triple": 3.0,
}
ADVERBS = ("once", "twice", "thrice")
"""Numbers of times that are one word."""
MULTIPLES = ("a single", "a double", "a triple")
"""Numbers of what is done: "a double kick"."""
SINGULAR = ("one", "1", *MULTIPLES)
"""Numbers before a noun that is not a plural."""
# The longest first, so that "half a dozen" is not "half a".
_WORDS = [word.replace(" ", "[ -]") for word in sorted(_VALUES.keys() - set(ADVERBS), key=len, reverse=True)]
# "1,200" is a thousand, and "1,2" is not.
NUMBER = "|".join([r"\d{1,6}(?:\.\d{1,6}|,(?!\d{3}\b)\d{1,6})?", *_WORDS])
START = r"(?<![\w.,/-])(?<!hundred )(?<!hundred and )(?<!thousand )"
"""What must be before a number, so that it is not the end of a larger one."""
ABOUT = (
    "about",
    "almost",
    "approximately",
    "around",
    "at least",
    "exactly",
    "just",
    "nearly",
    "only",
    "over",
    "roughly",
)
"""Words before a number that do not change it."""
_OTHERS = r"(?:his|her|its|their|another|the others?|others|everybody|everyone|people|the crowd|the audience)"


def pattern(*parts: str) -> re.Pattern[str]:
    """Returns a pattern that does not distinguish capital letters."""
    return re.compile("".join(parts), re.IGNORECASE)


_RANGE = pattern(
    rf"(?:\b(?:{NUMBER}|{'|'.join(ADVERBS)})(?:[ -]?(?:seconds?|secs?|minutes?|times?))?",
    r"(?:,? ?(?:or|to|[-\u2013\u2014])|,(?= ?(?:maybe|perhaps|possibly)))(?: ?(?:even|maybe|perhaps|possibly),?)? ?|",
    rf"\bbetween (?:{NUMBER}) and )$",
)
OWNERS = ("the", "his", "her", "its", "their", "your", "my")
"""Words before a part of the body or a side: "the left hand"."""
OWNER = f"(?:{'|'.join(OWNERS)})"
_OF_OTHERS = pattern(rf"\b(?:while|when|as) {_OTHERS} .*")


_HELD = r"(?:\b(?:grasp|grip|hold)(?:s|p?ed|p?ing)?\b|\bcarr(?:y|ies|ied|ying)\b|\bheld\b|\bwith (?=an? ))"
_NEAR = "(?:belts?|casts?|coats?|hips?|jackets?|laps?|pockets?|sides?|slings?|waists?)"
_BUSY_HAND = pattern(
    rf"{_HELD}[^,;]{{0,30}}? (?:in|with|under) (?:{OWNER} )?(?:left|right) (?:arm|hand)\b|",
    rf"\b(?:{OWNER}|(?:{OWNER} )?(?:left|right|other)) (?:arms?|fists?|hands?|palms?)(?: \w+(?:ing|ed)| still)? ",
    rf"(?:(?:against|behind|inside|on) {OWNER} (?!(?:left|other|right|way)\b)|",
    rf"(?:at|by|in|near) (?:{OWNER} )?(?:\w+ )?{_NEAR}\b)",
)
"""A hand that does something else: "with the left hand in his pocket", "holding a cup in the right hand"."""


def without_busy_hands(caption: str) -> str:
    """Returns a sentence without the hands that hold something or rest somewhere."""
    return _BUSY_HAND.sub(" ", caption)


def number_value(number: str) -> float:
    """Returns the value of a number in digits or words."""
    number = number.lower().replace("-", " ")
    return _VALUES[number] if number in _VALUES else float(number.replace(",", "."))


def ends_range(before: str) -> bool:
    """Returns whether a number after this text is the end of a range: "two or three", "between four and six"."""
    return _RANGE.search(before) is not None


def without_others(caption: str) -> str:
    """Returns a sentence without what it says of other people: "while his mother claps four times"."""
    return _OF_OTHERS.sub("", caption)
