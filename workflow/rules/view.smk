import rfpipe
from rfpipe.provenance import fingerprint
from rfpipe.store.files import digest_of


def every_view(wildcards):
    """The viewer's page of each scene and method."""
    return [
        f"results/report/view/{scene}_{method}.html"
        for scene, method in SETTINGS.acquisitions
    ]


def other_acquisitions(wildcards):
    """The transports of a scene by its other methods."""
    return [
        f"results/{wildcards.scene}/{method}/transport.json"
        for method in SETTINGS.methods_of(wildcards.scene)
        if method != wildcards.method
    ]


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
