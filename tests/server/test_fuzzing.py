"""Thousands of requests made from the OpenAPI description: no error of the server among them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from tests.server.harness import RIGHT, Running, SlowRig, running

pytestmark = pytest.mark.slow

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
CASES = 1000
"""Least number of requests, over all operations and modes of generation."""

FEW = {"GET /v1/health", "GET /v1/status", "GET /v1/rig", "GET /v1/rig/arrays"}
"""Operations without parameters, which get fewer requests."""


@pytest.fixture(scope="module")
def server() -> Iterator[Running]:
    with running(SlowRig()) as server:
        yield server


@pytest.mark.filterwarnings("ignore")  # of the generators, about the requests they make
def test_no_request_makes_the_server_fail(server: Running) -> None:
    schema = schemathesis.openapi.from_url(f"{server.url}/v1/openapi.json")
    statuses: Counter[int] = Counter()
    with requests.Session() as session:
        session.trust_env = False
        for result in schema.get_all_operations():
            operation = result.ok()
            for mode in GenerationMode:
                fuzz(operation, mode, session, statuses)
    assert sum(statuses.values()) >= CASES, statuses
    assert not [status for status in statuses if status >= 500]
    assert {200, 401, 404, 410, 422} & set(statuses) >= {200, 410, 422}


def fuzz(operation: Any, mode: GenerationMode, session: Any, statuses: Counter[int]) -> None:
    examples = 20 if operation.label in FEW else 160

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(operation.as_strategy(generation_mode=mode))
    def send(case: Any) -> None:
        response = case.call(session=session, headers=RIGHT)
        statuses[response.status_code] += 1
        case.validate_response(response, checks=CHECKS)

    try:
        send()
    except Exception as error:  # an operation without parameters has no negative cases
        if type(error).__name__ not in ("Unsatisfiable", "Unsatisfied"):
            raise
