"""Thousands of requests made from the OpenAPI description: no error of the server among them."""

from __future__ import annotations

import ast
import io
import json
import os
import struct
import zipfile
from collections import Counter
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from tests.server.harness import RIGHT, Running, SlowRig, running

from rfpipe.rigs.messages import MEDIA_TYPE, encode_patterns

pytestmark = pytest.mark.slow

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
TIMES = int(os.environ.get("RFPIPE_FUZZING_TIMES", "1"))
"""So many times as many cases as in the suite."""

CASES = 1000 * TIMES
"""At least so many in all, of the operations and ways of generation."""

FEW = {"GET /v1/health", "GET /v1/status", "GET /v1/rig", "GET /v1/rig/arrays",
       "GET /v1/preview.png"}  # fmt: skip
"""Operations without parameters, of which there is little to vary."""


@pytest.fixture(scope="module")
def server() -> Iterator[Running]:
    with running(SlowRig()) as server:
        yield server


def quiet(examples: int) -> settings:
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )


@pytest.mark.filterwarnings("ignore")  # of the generators, about the requests they make
def test_no_request_makes_the_server_fail(server: Running) -> None:
    schema = schemathesis.openapi.from_url(f"{server.url}/v1/openapi.json")
    seen: Counter[int] = Counter()
    with requests.Session() as session:
        session.trust_env = False
        for found in schema.get_all_operations():
            operation = found.ok()
            for mode in GenerationMode:
                fuzz(operation, mode, session, seen)
    assert sum(seen.values()) >= CASES, seen
    assert not [status for status in seen if status >= 500]
    assert {200, 401, 404, 410, 422} & set(seen) >= {200, 410, 422}


def fuzz(operation: Any, mode: GenerationMode, session: Any, seen: Counter[int]) -> None:
    examples = TIMES * (20 if operation.label in FEW else 160)

    @quiet(examples)
    @given(operation.as_strategy(generation_mode=mode))
    def send(case: Any) -> None:
        response = case.call(session=session, headers=RIGHT)
        seen[response.status_code] += 1
        case.validate_response(response, checks=CHECKS)

    try:
        send()
    except Exception as error:  # an operation without parameters has no negative cases
        if type(error).__name__ not in ("Unsatisfiable", "Unsatisfied"):
            raise


LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8),
    st.sampled_from(["<f4", "|u1", "<u2", 2**31, 10**30]),
)  # fmt: skip
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner)
)
TUPLES = st.lists(st.integers(-1, 9) | st.sampled_from([2**31, 2**62, 10**30])).map(tuple)


def test_no_message_makes_the_server_fail(server: Running) -> None:
    """Messages like those of a client, but for one thing in header or content."""
    patterns = np.zeros((2, 3, 7), np.float32)
    patterns[0, 1], patterns[1, 2] = 1, 1
    bodies = [
        encode_patterns(shown, [(1, 0), (1, 1)])
        for shown in (patterns, 1 - patterns, patterns * np.float32(0.3))
    ]
    seen: Counter[int] = Counter()
    with server.http() as http:
        lease = http.post("/v1/lease", json={"client": "fuzz"}).json()["lease"]

        @quiet(500 * TIMES)
        @given(st.sampled_from(bodies), st.data())
        def send(body: bytes, data: st.DataObject) -> None:
            headers = {
                "Rig-Lease": lease,
                "Idempotency-Key": f"fuzzing-{sum(seen.values()):012}",
                "Content-Type": MEDIA_TYPE,
            }
            answer = http.post("/v1/captures", content=harmed(body, data), headers=headers)
            seen[answer.status_code] += 1
            assert answer.status_code in (200, 422), answer.text

        send()
    assert seen[422] > 250 * TIMES
    assert httpx.get(f"{server.url}/v1/health", trust_env=False).is_success


def harmed(body: bytes, data: st.DataObject) -> bytes:
    """Change one thing in a message."""
    way = data.draw(st.sampled_from(["fact", "header", "content", "byte", "bytes", "cut"]))
    if way == "cut":
        return body[: data.draw(st.integers(0, len(body) - 1))]
    if way in ("byte", "bytes"):  # of the zip file's own headers, too
        changed = bytearray(body)
        count = 1 if way == "byte" else 8
        for place in data.draw(st.lists(st.integers(0, len(body) - 1), min_size=1, max_size=count)):
            changed[place] = data.draw(st.integers(0, 255))
        return bytes(changed)
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        facts, array = json.loads(archive.read("facts.json")), archive.read("patterns.npy")
    magic, header, content = array[:8], ast.literal_eval(array[10:128].decode()), array[128:]
    if way == "fact":
        facts[data.draw(st.sampled_from(sorted(facts)))] = data.draw(VALUES)
    elif way == "header":
        header[data.draw(st.sampled_from(sorted(header)))] = data.draw(VALUES | TUPLES)
    else:
        changed = bytearray(content)
        changed[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
        content = bytes(changed)
    text = repr(header).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("facts.json", json.dumps(facts))
        archive.writestr("patterns.npy", magic + struct.pack("<H", len(text)) + text + content)
    return buffer.getvalue()
