PAGE_TEMPLATE = Path(rfpipe.__file__).parent / "report" / "page.html.j2"


rule evaluate:
    """All errors, in one job because the colour library takes long to load."""
    input:
        relit=every_acquisition("relight.json"),
        verified=every_verification,  # their pictures are counted
    output:
        errors=report(
            "results/report/tables/errors.csv", caption="../report/errors.rst"
        ),
        speed_error=report(
            "results/report/tables/speed_error.csv",
            caption="../report/speed_error.rst",
        ),
    log:
        "results/report/evaluate.log",
    benchmark:
        "results/report/evaluate.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **ASKED,
    params:
        seconds_per_pattern=SETTINGS.capture.seconds_per_pattern,
        code=code_digest(pages=True),
    script:
        "../scripts/evaluate.py"


rule report:
    """Figures and tables of the acquired scenes, on one page."""
    input:
        relit=every_acquisition("relight.json"),
        errors="results/report/tables/errors.csv",
        speed_error="results/report/tables/speed_error.csv",
        views=every_view,
        verified=every_verification,
    output:
        page=report("results/report/index.html", caption="../report/report.rst"),
        numbers="results/report/results.json",
    log:
        "results/report/report.log",
    benchmark:
        "results/report/report.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **{**ASKED, "runtime": minutes(240)},
    params:
        settings=SHAPING,
        code=code_digest(pages=True),
        template=fingerprint(PAGE_TEMPLATE.read_text(encoding="utf-8")),
    script:
        "../scripts/report.py"
