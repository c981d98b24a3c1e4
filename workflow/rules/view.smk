import rfpipe
from rfpipe.provenance import fingerprint
from rfpipe.store.files import digest_of

# Digest of the viewer's code and web files.
VIEWER = fingerprint(
    [
        digest_of(path.read_bytes())
        for path in sorted(Path(rfpipe.__file__).with_name("viewer").rglob("*.*"))
        if path.suffix != ".pyc"
    ]
)


rule view:
    """The viewer's page of an acquisition, with another method's transport to compare."""
    input:
        transport="results/{scene}/{method}/transport.json",
        others=other_acquisitions,
    output:
        "results/report/view/{scene}_{method}.html",
    log:
        "results/{scene}/{method}/view.log",
    benchmark:
        "results/{scene}/{method}/view.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **ASKED,
    params:
        code=code_digest(pages=True),
        viewer=VIEWER,
    script:
        "../scripts/view.py"
