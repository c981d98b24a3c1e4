# Simulated scenes on which the methods are compared: no part of what a rig's report is about.
SHOWN_STUDIES = STUDIES if SETTINGS.capture.rig == "simulated" else []
if SETTINGS.report.figures is not None:
    SHOWN_STUDIES = [*SHOWN_STUDIES, *FIGURES]


PAGE_TEMPLATE = Path(rfpipe.__file__).parent / "report" / "page.html.j2"


rule studies:
    """What the report shows beside the acquired scenes."""
    output:
        "results/studies/{study}.json",
    log:
        "results/studies/{study}.log",
    benchmark:
        "results/studies/{study}.benchmark.tsv"
    wildcard_constraints:
        study="|".join([*STUDIES, *FIGURES]),
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **{**ASKED, "runtime": minutes(240)},
    params:
        settings=study_settings,
        code=code_digest(pages=True),
    script:
        "../scripts/studies.py"


rule evaluate:
    """All error figures, in one job since the colour library takes long to load."""
    input:
        relit=every_acquisition("relight.json"),
        swept=every_sweep("sweep.json"),
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
    threads: all_cores
    resources:
        **ASKED,
        workers=SETTINGS.resources.workers,
    params:
        seconds_per_pattern=SETTINGS.capture.seconds_per_pattern,
        code=code_digest(pages=True),
    script:
        "../scripts/evaluate.py"


rule report:
    """The thesis' figures and tables for the acquired scenes, on one page."""
    input:
        relit=every_acquisition("relight.json"),
        studies=expand("results/studies/{study}.json", study=SHOWN_STUDIES),
        errors="results/report/tables/errors.csv",
        speed_error="results/report/tables/speed_error.csv",
        views=every_view,
        verified=every_verification,
        # what `make bench` left, if anything, when the workflow starts
        benchmarks=sorted(map(str, Path("results/bench").glob("*.csv"))),
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
