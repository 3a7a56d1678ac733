"""All groups of prompt tests by name."""

from pathlib import Path

from t2m_jax.data.folder import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts import free
from t2m_jax.evaluation.prompts.following import PromptTest, action_tests
from t2m_jax.evaluation.prompts.groups import composed_tests, pace_tests
from t2m_jax.evaluation.prompts.people import kit_tests
from t2m_jax.evaluation.prompts.recognition import manner_tests


def prompt_tests(group: str, data: str | None) -> list[PromptTest]:
    """Returns the tests of a group.

    Raises:
        UserError: The group needs a data set, and none is given, or the other way round.
    """
    if group == "kit" and data is not None:
        return kit_tests(Path(data))
    with_data = {
        "paces": pace_tests,
        "manners": manner_tests,
        "free-paces": free.free_pace_tests,
        "free-manners": free.free_manner_tests,
        "then": free.then_tests,
        "all-actions": free.all_action_tests,
    }
    plain = {
        "actions": action_tests,
        "composed": composed_tests,
        "free": free.free_tests,
        "subjects": free.subject_tests,
        "typos": free.typo_tests,
        "while": free.while_tests,
        "counts": free.count_tests,
        "durations": free.duration_tests,
        "warnings": free.warning_tests,
    }
    if (group not in plain) != (data is not None):
        names = ", ".join(with_data)
        raise UserError(
            f"--data: is for --group {names}, which compare motion with real clips, and kit, which reads a file of "
            "captions; they need it"
        )
    return plain[group]() if data is None else with_data[group](open_dataset(data))
