"""Upload of a run's results to a bucket, without its captures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.services.buckets import BUCKET, proxy, s3_server, use
from tests.workflow.harness import Workflow

import rfpipe
from rfpipe.store import read_manifest

ADDRESS = f"s3://{BUCKET}/run"


@pytest.mark.slow
def test_a_run_uploads_its_results_to_a_bucket(
    of_ones_own: Workflow,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    validators: str,
) -> None:
    workflow = of_ones_own.copy_to(tmp_path / "run")
    settings = yaml.safe_load(workflow.config.read_text())
    settings["storage"] = {"keep_at": ADDRESS}
    workflow.config.write_text(yaml.safe_dump(settings))
    output = workflow.run("--default-storage-provider", "s3", "--dry-run", succeeds=False)
    assert "set storage.keep_at in place of it" in output
    with s3_server(validators) as server, proxy(server) as faults:
        use(monkeypatch, faults.endpoint)
        faults.deny = True
        output = workflow.run(succeeds=False)
        assert "AWS_SECRET_ACCESS_KEY" in output
        faults.deny = False
        workflow.run()
        manifest = read_manifest(workflow.path("kept.json"))
        assert manifest["address"] == ADDRESS
        assert manifest["sent"] == manifest["objects"] > 10
        assert not any("capture" in path for path in faults.written())
        names = [path for path in faults.written() if path.endswith("/transport.zip")]
        assert len(names) == 6  # two scenes by three methods
        uploaded = rfpipe.open_transport(f"s3:/{names[0]}")
        local = rfpipe.open_transport(
            tmp_path / names[0].removeprefix(f"/{BUCKET}/").replace(".zip", ".zarr")
        )
        assert uploaded.nbytes <= local.nbytes
        light = np.random.default_rng(0).random(uploaded.projector_shape)
        assert np.array_equal(uploaded.relight(light), local.relight(light))
