from t2m_jax.files.markdown import markdown_table

LINES = [("walk", "1", "**20.5**"), ("turn left", "", "3")]


def test_cells_are_as_short_as_they_can_be():
    assert markdown_table(("", "a", "b"), LINES).splitlines() == [
        "| | a | b |",
        "| --- | ---: | ---: |",
        "| walk | 1 | **20.5** |",
        "| turn left | | 3 |",
    ]


def test_columns_can_be_aligned_and_choose_their_side():
    assert markdown_table(("kind", "a", "b"), LINES, sides="<><", aligned=True).splitlines() == [
        "| kind      |    a | b        |",
        "| --------- | ---: | -------- |",
        "| walk      |    1 | **20.5** |",
        "| turn left |      | 3        |",
    ]
