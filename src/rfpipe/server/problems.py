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

PROBLEM_TYPE = "application/problem+json"


class Problem(BaseModel):
    """What went wrong."""

    title: str = Field(description="The status in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was wrong and what to do about it.")


def problem_response(
    status: int, detail: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Return an error's response."""
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return Response(problem.model_dump_json(), status, headers, PROBLEM_TYPE)


def add_handlers(app: FastAPI, statuses: Mapping[type[Exception], int]) -> None:
    """Answer every error of an application by a problem; of `statuses` the text is for the client.

    Bugs are answered without their text.
    """

    async def answered(_request: Request, error: Exception) -> Response:
        if isinstance(error, HTTPException):
            return problem_response(error.status_code, str(error.detail), error.headers)
        if isinstance(error, RequestValidationError):
            details = (f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
            return problem_response(422, "; ".join(details))
        if isinstance(error, ClientDisconnect):
            return problem_response(400, "the client closed the connection within its request")
        status = next((statuses[kind] for kind in type(error).__mro__ if kind in statuses), 500)
        if status == 500:
            return problem_response(500, "the server made a mistake; its log says more")
        come_again = {"Retry-After": "1"} if status in (409, 429, 503) else None
        return problem_response(status, str(error), come_again)

    for kind in (*statuses, HTTPException, RequestValidationError, ClientDisconnect, Exception):
        app.add_exception_handler(kind, answered)
