"""Answers that go on without a reader."""

import asyncio

import pytest
from starlette.exceptions import HTTPException

from t2m_jax.serving import kept
from t2m_jax.serving.jobs import Event
from t2m_jax.serving.kept import KeptAnswers

KEYS = [letter * 16 for letter in "abc"]


async def answer(events, gate=None, ends=None):
    """Yields events, the last one after the gate; notes that it was closed."""
    try:
        for event in events[:-1]:
            yield event
        if gate is not None:
            await gate.wait()
        yield events[-1]
    finally:
        if ends is not None:
            ends.append(True)


def events_of(*texts):
    return [Event("codes", text) for text in texts]


async def texts(events, count=None):
    found = []
    async for event in events:
        found.append(event.data)
        if len(found) == count:
            break
    return found


def test_an_answer_goes_on_and_can_be_read_again():
    async def test():
        answers, gate = KeptAnswers(), asyncio.Event()
        first = answers.start(KEYS[0], answer(events_of("a", "b", "c"), gate))
        assert await texts(first, count=2) == ["a", "b"]
        second = asyncio.create_task(texts(answers.follow(KEYS[0])))
        await asyncio.sleep(0)
        gate.set()
        assert await second == await texts(answers.follow(KEYS[0])) == ["a", "b", "c"]
        with pytest.raises(HTTPException, match="already a request with this key"):
            answers.check(KEYS[0])

    asyncio.run(test())


def test_a_request_that_nobody_needs_is_canceled():
    async def test():
        answers, ends = KeptAnswers(), []
        events = answers.start(KEYS[0], answer(events_of("a", "b"), asyncio.Event(), ends))
        assert await texts(events, count=1) == ["a"] and not ends
        answers.forget(KEYS[0])
        await asyncio.sleep(0.01)
        assert ends
        with pytest.raises(HTTPException, match="no longer has this motion"):
            answers.follow(KEYS[0])

    asyncio.run(test())


def test_answers_are_not_kept_forever(monkeypatch):
    async def test():
        answers = KeptAnswers()
        for key in KEYS:
            await texts(answers.start(key, answer(events_of("a" * 40))))
            await asyncio.sleep(0)
        with pytest.raises(HTTPException):
            answers.follow(KEYS[0])  # more than 100 bytes: the oldest one has gone
        assert await texts(answers.follow(KEYS[2]))
        await asyncio.sleep(0.1)
        for key in KEYS:
            with pytest.raises(HTTPException):
                answers.follow(key)

    monkeypatch.setattr(kept, "MAX_KEPT", 100)
    monkeypatch.setattr(kept, "KEEP_SECONDS", 0.05)
    asyncio.run(test())


def test_the_end_of_a_forgotten_answer_does_not_end_a_newer_one_with_its_key(monkeypatch):
    async def test():
        answers = KeptAnswers()
        await texts(answers.start(KEYS[0], answer(events_of("a"))))
        await asyncio.sleep(0)
        answers.forget(KEYS[0])
        await asyncio.sleep(0.03)
        await texts(answers.start(KEYS[0], answer(events_of("b"))))
        await asyncio.sleep(0.03)
        assert await texts(answers.follow(KEYS[0]))

    monkeypatch.setattr(kept, "KEEP_SECONDS", 0.05)
    asyncio.run(test())


@pytest.mark.parametrize("key", ["", "short", "x" * 65, "x" * 15 + "/", "x" * 15 + "é"])
def test_keys_are_long_and_plain(key):
    with pytest.raises(HTTPException, match="keep: a key has 16 to 64"):
        KeptAnswers().check(key)
