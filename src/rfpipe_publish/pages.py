"""What a reader sees first: a page about the publication, an example that runs, how to cite it."""

from __future__ import annotations

from collections.abc import Collection

import yaml

from rfpipe.provenance import versions
from rfpipe_publish.citation import Citation
from rfpipe_publish.run import Run

EXAMPLE, CITATION, PREVIEW = "read.py", "CITATION.cff", "ro-crate-preview.html"


def pages(
    run: Run, citation: Citation, meanings: dict[str, str], names: Collection[str]
) -> dict[str, bytes]:
    """Return the pages about a publication, by name.

    Parameters
    ----------
    run : Run
    citation : Citation
    meanings : dict of str to str
        What is to be found in it: names, and what they are.
    names : collection of str
        Of all other files.
    """
    from jinja2 import Environment, PackageLoader, select_autoescape

    templates = Environment(
        loader=PackageLoader("rfpipe_publish", "."),
        autoescape=select_autoescape(["html.j2"]),
        keep_trailing_newline=True,
    )
    templates.filters["times"] = lambda shape: " x ".join(map(str, shape))
    views = "results/report/view/"
    values = {
        "acquisitions": run.acquisitions,
        "citation": citation,
        "meanings": meanings,
        "names": names,
        "version": versions()["rfpipe"],
        "first": run.acquisitions[0].store_name,
        "views": sorted(n for n in names if n.startswith(views) and n.endswith(".html")),
    }
    values["example"] = templates.get_template("read.py.j2").render(values)
    made = {
        EXAMPLE: values["example"],
        CITATION: _citation_cff(citation),
        "README.md": templates.get_template("README.md.j2").render(values),
        PREVIEW: templates.get_template("page.html.j2").render(values),
    }
    return {name: str(text).encode() for name, text in made.items()}


def _citation_cff(citation: Citation) -> str:
    """Return how to cite a publication, as a Citation File Format file."""
    data = {
        "cff-version": "1.2.0",
        "message": "If you use these data, please cite them.",
        "type": "dataset",
        "title": citation.title,
        "version": citation.version,
        "date-released": citation.published.isoformat(),
        "abstract": citation.description,
        "keywords": list(citation.keywords),
        "license-url" if citation.license.startswith("http") else "license": citation.license,
        "authors": [
            {"name": creator.name, **({"orcid": creator.orcid_url} if creator.orcid else {})}
            for creator in citation.creators
        ],
        **({"doi": citation.doi} if citation.doi else {}),
    }
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=98)
