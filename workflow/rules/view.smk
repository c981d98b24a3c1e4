rule view:
    """A page for each acquisition: light the scene in a browser, wipe to another method's."""
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
