"""Findings of calibration steps, and verdicts on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.rules import RULES, Rule
from rfpipe.rigs.calibrated import STANDINGS

Standing = Literal["good", "poor", "unknown", "failed"]
Facts = Mapping[str, Any]


class Verdict(NamedTuple):
    """Judgement of a step's measurement.

    Attributes
    ----------
    standing : {"good", "poor", "unknown", "failed"}
        "unknown": the noise is too large to decide. "failed": the measurement was impossible.
    text : str
        Numbers, reason and remedy.
    """

    standing: Standing
    text: str

    def __str__(self) -> str:
        """Format standing and text for people."""
        return f"{STANDINGS[self.standing]}. {self.text}"


@dataclass(frozen=True)
class Findings:
    """Result of a step.

    Attributes
    ----------
    verdict : Verdict
    facts : mapping
        Plain data: numbers with their standard errors.
    arrays : mapping of str to ndarray
        Arrays for the rig, for later steps and for the report's pictures.
    """

    verdict: Verdict
    facts: Facts = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, step: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Findings:
        """Judge the facts of a step, and combine verdict, facts and arrays."""
        plain = {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in facts.items()
        }
        return cls(verdict_of(step, plain), plain, arrays)

    def __getitem__(self, name: str) -> Any:
        """Array or fact with this name."""
        return self.arrays[name] if name in self.arrays else self.facts[name]


def with_error(value: float, error: float, number: str) -> str:
    """Format a number with its standard error, or as a bound where the error exceeds the number.

    `number` is the format of both, as in "{:.3g} electrons".
    """
    if error < abs(value):
        return f"{number.format(value)} +- {number.format(error)}"
    return f"at most {number.format(abs(value) + 2 * error)}"


def verdict_of(step: str, facts: Facts) -> Verdict:
    """Judge the facts of a step by the rules of `rfpipe.calibration.rules`."""
    applying: dict[str, list[Rule]] = {"poor": [], "unknown": [], "good": [], "note": []}
    for rule in RULES:
        if rule.step == step and _applies(rule, facts):
            applying[rule.standing].append(rule)
    standing: Standing = "good"
    if applying["poor"] or applying["unknown"]:
        standing = "poor" if applying["poor"] else "unknown"
    sentences = [
        rule.text.format_map({**facts, "limit": _limit(rule, facts)})
        for rule in applying[standing] + applying["note"]
    ]
    return Verdict(standing, " ".join(sentences))


def _limit(rule: Rule, facts: Facts) -> float:
    """Limit of a rule, resolved to a number; 0 for a rule without a condition."""
    limit = rule.below if rule.above is None else rule.above
    return float(facts[limit] if isinstance(limit, str) else limit or 0)


def _applies(rule: Rule, facts: Facts) -> bool:
    """Test whether a rule has no condition, or its fact is beyond the limit."""
    if not rule.fact:
        return True
    value = facts.get(rule.fact)
    if value is None:
        return False
    limit = _limit(rule, facts)
    return bool(value < limit if rule.above is None else value > limit)
