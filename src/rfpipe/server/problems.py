"""Errors as ``application/problem+json`` (RFC 9457): a status, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response

__all__ = ["PROBLEM_TYPE", "Problem", "add_handlers", "problem_body", "problem_response"]

PROBLEM_TYPE = "application/problem+json"

_COME_AGAIN = (409, 429, 503)


class Problem(BaseModel):
    """What went wrong."""

    title: str = Field(description="The status in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was wrong and what to do about it.")


def problem_body(status: int, detail: str) -> bytes:
    """Return the body of an error's response."""
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return problem.model_dump_json().encode()


def problem_response(status: int, detail: str, headers: dict[str, str] | None = None) -> Response:
    """Return an error's response."""
    return Response(problem_body(status, detail), status, headers, PROBLEM_TYPE)


def add_handlers(app: FastAPI, statuses: Mapping[type[Exception], int]) -> None:
    """Answer every error of an application in this way.

    Parameters
    ----------
    app : FastAPI
    statuses : mapping
        The status of errors whose text is meant for the client.
    """

    async def of_kind(_request: Request, error: Exception) -> Response:
        status = next(statuses[kind] for kind in type(error).__mro__ if kind in statuses)
        headers = {"Retry-After": "1"} if status in _COME_AGAIN else None
        return problem_response(status, str(error), headers)

    for kind in statuses:
        app.add_exception_handler(kind, of_kind)

    @app.exception_handler(HTTPException)
    async def of_http(_request: Request, error: HTTPException) -> Response:
        headers = dict(error.headers) if error.headers else None
        return problem_response(error.status_code, str(error.detail), headers)

    @app.exception_handler(RequestValidationError)
    async def of_validation(_request: Request, error: RequestValidationError) -> Response:
        problems = [
            f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}" for problem in error.errors()
        ]
        return problem_response(422, "; ".join(problems))

    @app.exception_handler(ClientDisconnect)
    async def of_disconnect(_request: Request, _error: ClientDisconnect) -> Response:
        return problem_response(400, "the client closed the connection within its request")

    @app.exception_handler(Exception)
    async def of_bug(_request: Request, _error: Exception) -> Response:
        return problem_response(500, "the server made a mistake; its log says more")
