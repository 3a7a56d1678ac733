"""YAML files: what is written is read back, and what could grow, run or hide something is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.errors import UserError
from t2m_jax.yaml_file import load_yaml, yaml_text

texts = st.text().filter(lambda text: "${" not in text)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | texts
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4), max_leaves=20
)


@given(data=st.dictionaries(texts, values, max_size=5))
def test_writing_and_reading_is_the_identity(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("yaml") / "x.yaml"
    path.write_text(yaml_text(data), encoding="utf-8", newline="\n")
    assert load_yaml(path).data == data


def test_lines_are_those_of_the_keys(tmp_path):
    (tmp_path / "x.yaml").write_text("# first\na: 1\nb:\n  c: {d: 2,\n      e: 3}\n  f: [{g: 1}]\n")
    lines = load_yaml(tmp_path / "x.yaml").lines
    keys = {("a",): 2, ("b",): 3, ("b", "c"): 4, ("b", "c", "d"): 4, ("b", "c", "e"): 5, ("b", "f"): 6}
    assert lines == keys


@pytest.mark.parametrize(("text", "number"), [("1e-4", 1e-4), ("1E5", 1e5), ("-2.5e3", -2500.0), (".inf", math.inf)])
def test_exponents_are_numbers_and_in_quotes_text(tmp_path, text, number):
    (tmp_path / "x.yaml").write_text(f"a: {text}\nb: '{text}'\n")
    assert load_yaml(tmp_path / "x.yaml").data == {"a": number, "b": text}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a:\n- {b: 1,\n   b: 2}", "x.yaml:3: cannot read this YAML: found duplicate key 'b'"),
        ("a: [1, &x 2]", "x.yaml:1: cannot read this YAML: anchors"),
        ("a: [*x]", "x.yaml:1: cannot read this YAML: anchors"),
        ("a: [!!python/name:os.system x]", "x.yaml:1: cannot read this YAML: tags"),
        ("a: {b: ['${c}']}", "x.yaml:1: cannot read this YAML: interpolation"),
    ],
)
def test_hidden_features_are_refused_at_every_depth(tmp_path, text, message):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_yaml(path)
    assert str(caught.value).replace(f"{tmp_path}/", "").startswith(message)
