"""Embeddings on disk: what was kept comes back exactly, and what is damaged never does."""

import logging
import os
import sqlite3
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import platformdirs
import pytest

from t2m_jax.text.embedding_cache import CACHE_FILE, CAPTIONS_A_QUERY, EmbeddingCache

CAPTIONS = ["", "a person walks", "人が歩く", "it's 'quoted'; DROP TABLE embeddings", "a person walks "]


def embeddings(captions=CAPTIONS, *, seed: int = 0):
    generator = np.random.default_rng(seed)
    return {caption: generator.normal(size=6).astype(np.float32) for caption in captions}


def assert_same(found, wanted):
    assert found.keys() == wanted.keys()
    for caption, embedding in wanted.items():
        assert found[caption].dtype == np.float32
        np.testing.assert_array_equal(found[caption], embedding)


@pytest.fixture
def cache(tmp_path):
    return EmbeddingCache(tmp_path / "cache.sqlite3")


def test_what_was_kept_comes_back(cache):
    assert cache.load("model", CAPTIONS) == {}
    cache.save("model", embeddings())
    assert_same(EmbeddingCache(cache.path).load("model", [*CAPTIONS, "never seen"]), embeddings())
    assert_same(cache.load("model", CAPTIONS[1:2]), {CAPTIONS[1]: embeddings()[CAPTIONS[1]]})


def test_models_are_kept_apart(cache):
    cache.save("one", embeddings(seed=1))
    cache.save("other", embeddings(seed=2))
    assert_same(cache.load("one", CAPTIONS), embeddings(seed=1))
    assert_same(cache.load("other", CAPTIONS), embeddings(seed=2))
    assert cache.load("third", CAPTIONS) == {}


def test_more_captions_than_a_query_takes(cache):
    many = embeddings([f"caption {number}" for number in range(2 * CAPTIONS_A_QUERY + 1)])
    cache.save("model", many)
    assert_same(cache.load("model", list(many)), many)


def test_a_later_embedding_replaces_an_earlier_one(cache):
    cache.save("model", embeddings(seed=1))
    cache.save("model", embeddings(seed=2))
    assert_same(cache.load("model", CAPTIONS), embeddings(seed=2))


def test_the_default_is_in_the_users_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(tmp_path / name))
    cache = EmbeddingCache()
    assert cache.path == tmp_path / "t2m_jax" / CACHE_FILE
    assert not cache.path.parent.exists()
    cache.save("model", embeddings())
    assert cache.path.is_file()


def test_several_may_write_at_a_time(cache):
    def write(number: int) -> None:
        EmbeddingCache(cache.path).save("model", embeddings([f"{number}-{row}" for row in range(20)], seed=number))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(16)))
    captions = [f"{number}-{row}" for number in range(16) for row in range(20)]
    assert set(cache.load("model", captions)) == set(captions)


@pytest.mark.parametrize(
    "content", [b"not a database at all" * 50, b"\x00" * 4096, b"SQLite format 3\x00" + b"\xff" * 4080]
)
def test_a_file_that_is_no_cache_is_set_aside_and_begun_anew(content, cache, caplog):
    cache.path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        cache.save("model", embeddings())
    assert str(cache.path) in caplog.text
    cache.save("model", embeddings())
    assert_same(cache.load("model", CAPTIONS), embeddings())
    assert cache.path.with_name(cache.path.name + ".damaged").read_bytes() == content


def test_a_table_of_another_make_is_set_aside(cache, caplog):
    with sqlite3.connect(cache.path) as connection:
        connection.execute("CREATE TABLE embeddings (something TEXT)")
    connection.close()
    assert cache.load("model", CAPTIONS) == {}
    assert "damaged" in caplog.text
    cache.save("model", embeddings())
    assert_same(cache.load("model", CAPTIONS), embeddings())


@pytest.mark.parametrize(
    "change", ["embedding = zeroblob(24)", "embedding = 'text'", "digest = x'00'", "caption = 'x'"]
)
def test_a_damaged_row_is_not_handed_out(change, cache, caplog):
    cache.save("model", embeddings())
    with sqlite3.connect(cache.path) as connection:
        connection.execute(f"UPDATE embeddings SET {change} WHERE caption = ?", [CAPTIONS[1]])
    connection.close()
    found = cache.load("model", [*CAPTIONS, "x"])
    wanted = embeddings()
    del wanted[CAPTIONS[1]]
    assert_same(found, wanted)
    assert "computed again" in caplog.text


def test_any_damage_gives_right_embeddings_or_none(cache):
    many = embeddings([f"caption {number}" for number in range(100)])
    cache.save("model", many)
    sound = cache.path.read_bytes()
    generator = np.random.default_rng(3)
    for trial in range(60):
        damaged = bytearray(sound)
        if trial % 3 == 0:
            del damaged[generator.integers(len(sound)) :]
        else:
            for place in generator.integers(len(sound) if trial % 3 == 1 else 200, size=20):
                damaged[place] = generator.integers(256)
        cache.path.write_bytes(damaged)
        found = cache.load("model", list(many))
        assert_same(found, {caption: many[caption] for caption in found})
        for _ in range(2):
            cache.save("model", {caption: many[caption] for caption in many if caption not in found})
        assert_same(found | cache.load("model", list(many)), many)


def test_a_place_that_cannot_be_written_is_done_without(tmp_path, caplog):
    (tmp_path / "file").write_text("in the way")
    cache = EmbeddingCache(tmp_path / "file" / "cache.sqlite3")
    cache.save("model", embeddings())
    assert cache.load("model", CAPTIONS) == {}
    assert caplog.text.count("cannot be used") == 2
    folder = EmbeddingCache(tmp_path)
    assert folder.load("model", CAPTIONS) == {}
    assert tmp_path.is_dir()


@pytest.mark.skipif(os.geteuid() == 0, reason="the administrator may write everywhere")
def test_a_cache_that_may_only_be_read_still_serves(cache):
    cache.save("model", embeddings())
    cache.path.chmod(0o444)
    cache.path.parent.chmod(0o555)
    try:
        assert_same(cache.load("model", CAPTIONS), embeddings())
        cache.save("model", embeddings(["new"]))
        assert cache.path.is_file()
    finally:
        cache.path.parent.chmod(0o755)
