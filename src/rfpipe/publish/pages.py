"""What a reader sees first: a page about the publication, an example that runs, how to cite it."""

from __future__ import annotations

import textwrap
from collections.abc import Collection
from typing import Any

import yaml

from rfpipe.provenance import versions
from rfpipe.publish.citation import Citation
from rfpipe.publish.contents import Acquisition, Run

__all__ = ["EXAMPLE", "citation_cff", "example", "page", "readme"]

EXAMPLE = "read.py"
_REPORT, _VIEWS = "results/report/index.html", "results/report/view/"

_EXAMPLE = '''\
"""Relight this publication: python read.py [its folder, zip file or address]."""
import sys
import numpy as np
import rfpipe  # version {version}; for addresses with its extra, publish
where = sys.argv[1] if len(sys.argv) > 1 else sys.path[0]
transport = rfpipe.open_transport(f"{{where}}/{name}")
light = np.zeros(transport.projector_shape, np.float32)
light[..., light.shape[-1] // 2 :] = 1  # the right half of the projector is lit
image = transport.relight(light)  # radiance: the camera's rows x columns x channels
print(transport, image.shape, "mean", image.mean(), "brightest", image.max())
'''

_README = """\
# {title}

{description}

{acquired}

| file | what it is |
|---|---|
{files}

## Read it

`{example}` opens a transport and relights it, from this folder, from the zip file or from an
address that serves either; over the network it fetches only what it reads:

    python {example}                                   # the folder in which it lies
    python {example} crate.zip
    python {example} https://example.org/crate.zip     # or s3://bucket/crate.zip

It was written by rfpipe {version}, which relights it. Install that from a clone of its repository,
*rfpipe: acquire, store and relight the light transport between a projector and a camera*: there,
run `pip install .`, or `pip install '.[publish]'` to read addresses, too. On package indexes,
another program has its name. Without rfpipe, any reader of zarr 3 opens the stores:
`zarr.open_group("{name}")`.

Whether all files are what they were: `rfpipe verify`, or `sha256sum -c {manifest}`.

## Cite it

{citation}

Licence: [{license}]({license_url}).
"""


def example(first: Acquisition) -> str:
    """Return the reader's example: ten lines that open a transport and relight it."""
    return _EXAMPLE.format(version=versions()["rfpipe"], name=f"{first.name}/{first.store.name}")


def readme(
    run: Run, citation: Citation, files: dict[str, str], manifest: str, first: Acquisition
) -> str:
    """Return the page about a publication, in Markdown.

    Parameters
    ----------
    files : dict of str to str
        What is to be found in it: names, and what they are.
    """
    acquired = "\n".join(
        f"- {found.scene} by {found.method}: {found.facts['patterns']:,} patterns, camera "
        f"{_times(found.facts['camera_shape'])}, projector {_times(found.facts['projector_shape'])}"
        f", {found.facts['channels']} channel{'s' if found.facts['channels'] > 1 else ''}"
        for found in run.acquisitions
    )
    listed = "\n".join(f"| `{name}` | {meaning} |" for name, meaning in files.items())
    return _README.format(
        title=citation.title,
        description=textwrap.fill(citation.description, 100),
        acquired=acquired,
        files=listed,
        example=EXAMPLE,
        version=versions()["rfpipe"],
        name=f"{first.name}/{first.store.name}",
        manifest=manifest,
        citation=citation.text,
        license=citation.license,
        license_url=citation.license_url,
    )


def page(run: Run, citation: Citation, files: dict[str, str], names: Collection[str]) -> str:
    """Return the page about a publication, in HTML: what the scenes look like, and where all is.

    Parameters
    ----------
    files : dict of str to str
        What is to be found in it: names, and what they are.
    names : collection of str
        Of all files.
    """
    from jinja2 import Environment, PackageLoader

    pictured = []
    for found in run.acquisitions:
        picture = f"pictures/{found.scene}/{found.method}/floodlit"
        pictured.append(
            {
                "scene": found.scene,
                "method": found.method,
                "patterns": f"{found.facts['patterns']:,}",
                "shape": _times(found.facts["camera_shape"]),
                "picture": f"{picture}.png" if f"{picture}.png" in names else None,
                "exr": f"{picture}.exr",
            }
        )
    template = Environment(loader=PackageLoader("rfpipe.publish", "."), autoescape=True)
    text: str = template.get_template("page.html.j2").render(
        citation=citation,
        report=_REPORT if _REPORT in names else None,
        views=sorted(n for n in names if n.startswith(_VIEWS) and n.endswith(".html")),
        acquisitions=pictured,
        example=example(run.acquisitions[0]),
        files=files,
    )
    return text


def citation_cff(citation: Citation) -> str:
    """Return how to cite a publication, as a Citation File Format file."""
    is_url = citation.license.startswith("http")
    data: dict[str, Any] = {
        "cff-version": "1.2.0",
        "message": "If you use these data, please cite them.",
        "type": "dataset",
        "title": citation.title,
        "version": citation.version,
        "date-released": citation.published.isoformat(),
        "abstract": citation.description,
        "keywords": list(citation.keywords),
        "license-url" if is_url else "license": citation.license,
        "authors": [
            {
                "name": creator.name,
                **({"orcid": f"https://orcid.org/{creator.orcid}"} if creator.orcid else {}),
            }
            for creator in citation.creators
        ],
        **({"doi": citation.doi} if citation.doi else {}),
    }
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=98)


def _times(shape: list[int]) -> str:
    return " x ".join(map(str, shape))
