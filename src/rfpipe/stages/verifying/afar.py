"""Checking what lies behind an address: all bytes are fetched, and nothing is kept."""

from __future__ import annotations

from typing import IO

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.stages.verifying.findings import Checked, Mend
from rfpipe.stages.verifying.published import LIST, check_list, listed_names
from rfpipe.stages.verifying.stores import first_sentence
from rfpipe.store import open_arrays
from rfpipe.store.places import METADATA, Place, content_of, locate
from rfpipe.transport.storage import ZIP_NAME, transports_in

__all__ = ["check_afar"]

_COPY = Mend("restore")


class _Files:
    """The files behind an address; of a web server, which doesn't list them, those it should have.

    Parameters
    ----------
    place : Place
    listed : bytes
        The list of files and their SHA-256.
    """

    def __init__(self, place: Place, listed: bytes) -> None:
        self.path = place
        try:
            self.names = set(place.files())
        except StoreError:
            self.names = {LIST, *listed_names(listed)}

    def open(self, name: str) -> IO[bytes]:
        return (self.path / name).open()


def check_afar(place: Place, checked: Checked) -> None:
    """Check a folder with a list of its files, or a transport or folder of transports.

    Parameters
    ----------
    place : Place
    checked : Checked

    Raises
    ------
    InputError
        When there is neither.
    StoreError
        When the server doesn't answer.
    """
    listed = content_of(place / LIST)
    if listed is not None:
        check_list(_Files(place, listed), checked)
        return
    is_store = content_of(place / METADATA) is not None
    stores = [place] if is_store else [place / name for name in transports_in(place)]
    if not stores:
        raise InputError(
            f"{place}: has no {LIST} and no transport; expected what 'rfpipe keep' or 'rfpipe "
            "publish' made, or a transport"
        )
    for store in stores:
        if store.key.endswith(ZIP_NAME):
            inside = locate(store)
            assert isinstance(inside, Place)
            check_afar(inside, checked)
        else:
            _check_bundle(store, checked)


def _check_bundle(place: Place, checked: Checked) -> None:
    checked.stores += 1
    try:
        bundle = open_arrays(place)
    except IntegrityError as error:
        checked.wrong(place, first_sentence(error, place), _COPY)
        return
    for name in bundle.names:
        try:
            checked.read(bundle.read(name).nbytes)
        except IntegrityError as error:
            checked.wrong(place, first_sentence(error, place), _COPY)
