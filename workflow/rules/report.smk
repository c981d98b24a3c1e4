from rfpipe.errors import RfpipeError


def every_item(wildcards):
    """Inputs of the catalogue besides the transports."""
    relit = [
        f"results/{scene}/{method}/relight.json"
        for scene, method in SETTINGS.acquisitions
        if SETTINGS.scenes[scene].has_truth
    ]
    return [*relit, *every_verification(wildcards), *every_view(wildcards)]


def list_collection():
    """Write the catalogue of a collection in its present state."""
    if SETTINGS.collection is None:
        return
    from rfpipe.report.catalogue import write_catalogue

    try:
        counts = write_catalogue(SETTINGS, Path("results"))
    except RfpipeError as error:  # a page more or less doesn't change how a run ended
        print(f"rfpipe: no catalogue: {error}")
        return
    states = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print(f"rfpipe: results/catalogue/index.html: {states}")


def report_remaining(failures):
    """Write the report of the acquisitions in which no job failed, in a run that keeps going."""
    failed = {
        (failure.scene, failure.method): failure
        for failure in failures
        if failure.scene
    }
    if not failed or len(failed) < len(failures) or not SETTINGS.has_report:
        return
    from rfpipe.report.partial import build_partial_report

    try:
        page = build_partial_report(SETTINGS, Path("results"), failed)
    except RfpipeError as error:
        print(f"rfpipe: no report of the remaining acquisitions: {error}")
    else:
        print(f"rfpipe: report of the remaining acquisitions: {page}" if page else "")


PAGE_TEMPLATE = Path(rfpipe.__file__).parent / "report" / "page.html.j2"


rule evaluate:
    """All errors, in one job because the colour library takes long to load."""
    input:
        relit=every_acquisition("relight.json"),
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
