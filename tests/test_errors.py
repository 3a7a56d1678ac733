"""Messages of mistakes."""

from t2m_jax.errors import MAX_LINE, UserError


def test_a_long_message_is_cut_between_words():
    names = [f"left_joint_{number}" for number in range(100)]
    words = str(UserError(f"file: {' '.join(names)} were not recognized")).split()
    assert {"file:", "...", "recognized"} <= set(words) <= {"file:", "...", "were", "not", "recognized", *names}


def test_a_message_of_one_long_word_is_cut_in_it():
    assert MAX_LINE - 2 < len(str(UserError("x" * 1000))) <= MAX_LINE
