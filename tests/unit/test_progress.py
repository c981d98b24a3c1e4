"""Progress in log files: plain lines, with a time to go only where there is a total."""

from __future__ import annotations

import logging

import pytest

from rfpipe.jobs import job
from rfpipe.jobs.job import Progress


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "_SECONDS_BETWEEN_LINES", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: False, raising=False)


@pytest.mark.parametrize(
    ("total", "done", "counts", "lines"),
    [
        (40, 0, [10, 30], ["10 of 40 patterns, 01:30 to go", "40 of 40 patterns, 00:00 to go"]),
        (40, 20, [1], ["21 of 40 patterns, 09:30 to go"]),
        (9000, 0, [1], ["1 of 9,000 patterns, 74:59:30 to go"]),
        (0, 0, [17], ["17 patterns"]),
        (0, 0, [1], ["1 pattern"]),
        (4, 0, [5], ["5 patterns"]),
    ],
)
def test_a_line_has_the_remaining_time_if_the_total_is_known(
    total: int,
    done: int,
    counts: list[int],
    lines: list[str],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = iter(range(0, 3000, 30))
    monkeypatch.setattr(job, "monotonic", lambda: next(clock))
    with caplog.at_level(logging.INFO, "rfpipe"), Progress("level 3", total, done) as bar:
        for count in counts:
            bar.advance(count)
    assert caplog.messages == [f"level 3: {line}" for line in lines]


def test_nested_bars_leave_no_terminal_codes(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "rfpipe"), Progress("level 0", 3) as outer:
        with Progress("light", 2, unit="step") as inner:
            inner.advance(1)
        outer.advance(1)
    assert len(caplog.messages) == 2
    assert all(message.isprintable() for message in caplog.messages)
