"""What a process knows about the others of its run, from their beats; see `t2m_jax.distributed`."""

from collections.abc import Mapping

GRACE = 2.0
"""Seconds in which a process may fail with the error of its peer itself, and then shows its own message."""


class Peers:
    """What is known about the other processes. Time is counted in beats, so a suspended computer loses nothing."""

    def __init__(self, *, process_id: int, num_processes: int, heartbeat: int, stall: int):
        self._me, self._count, self._heartbeat, self._stall = process_id, num_processes, heartbeat, stall
        self._now = self._last_answer = self._last_progress = 0.0
        self._beats = dict.fromkeys(range(num_processes), ("", 0.0))
        self._failures: dict[int, tuple[str, float]] = {}

    def wait(self, seconds: float) -> None:
        """Counts time."""
        self._now += seconds

    def see(self, beats: Mapping[int, str], failures: Mapping[int, str]) -> None:
        """Takes what the coordinator has: per process a beat, `"BEATS PROGRESS"`, and why it failed."""
        before = self._progress()
        for peer, beat in beats.items():
            if beat != self._beats[peer][0]:
                self._beats[peer] = beat, self._now
        if self._progress() != before:
            self._last_progress = self._now
        for peer, message in failures.items():
            self._failures.setdefault(peer, (message, self._now))
        self._last_answer = self._now

    def problem(self) -> str | None:
        """Returns why this process must end, None if there is no reason."""
        for peer, (message, since) in self._failures.items():
            if peer != self._me and self._now - since >= GRACE:
                return f"process {peer} of {self._count} has ended: {message}"
        if self._now - self._last_answer >= self._heartbeat:
            return self._no_answer("process 0")
        # Nothing is known about the others since the coordinator answered last.
        silent = [peer for peer, (_, seen) in self._beats.items() if self._last_answer - seen >= self._heartbeat]
        if silent:
            return self._no_answer(f"process{'es' if len(silent) > 1 else ''} {', '.join(map(str, silent))}")
        if 0 < self._stall <= self._now - self._last_progress:
            progress = self._progress()
            slowest = [peer for peer in progress if progress[peer] == min(progress.values())]
            which = f"process {slowest[0]} of {self._count}" if len(slowest) == 1 else f"one of {self._count} processes"
            return (
                f"{which} is stuck: no update for {self._stall} s; look at it with `py-spy dump`, then resume the run"
            )
        return None

    def _no_answer(self, which: str) -> str:
        return (
            f"{which} of {self._count} has not answered for {self._heartbeat} s; see its log, then start all processes "
            "again with --resume"
        )

    def _progress(self) -> dict[int, int]:
        return {peer: int((beat or "0 0").split()[1]) for peer, (beat, _) in self._beats.items()}
