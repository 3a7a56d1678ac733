"""The fifteen word classes of the evaluator (Guo et al. 2022)."""

TAGS = ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV")
"""Tags of caption files that have a class of their own."""

_SPECIAL_WORDS = {
    "Loc_VIP": """
        left right clockwise counterclockwise anticlockwise forward back backward up down straight curve
    """,
    "Body_VIP": """
        arm chin foot feet face hand mouth leg waist eye knee shoulder thigh
    """,
    "Obj_VIP": """
        stair dumbbell chair window floor car ball handrail baseball basketball
    """,
    "Act_VIP": """
        walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise wash stand
        kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb
    """,
    "Desc_VIP": """
        slowly carefully fast careful slow quickly happy angry sad happily angrily sadly
    """,
}
SPECIAL_WORDS = {name: tuple(words.split()) for name, words in _SPECIAL_WORDS.items()}
"""Words that matter for motion (location, body, object, action, manner). Their class counts more than their tag."""

PARTS_OF_SPEECH = (*TAGS, *SPECIAL_WORDS, "OTHER")
"""All classes, in the order of their numbers."""

OTHER = PARTS_OF_SPEECH.index("OTHER")

_CLASS_OF_WORD = {word: PARTS_OF_SPEECH.index(name) for name, words in SPECIAL_WORDS.items() for word in words}
_CLASS_OF_TAG = {tag: number for number, tag in enumerate(TAGS)}


def part_of_speech(word: str, tag: str) -> int:
    """Returns the class number of a word: the class of the word if it is special, else that of its tag, else OTHER."""
    return _CLASS_OF_WORD.get(word, _CLASS_OF_TAG.get(tag, OTHER))
