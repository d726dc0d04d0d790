"""What the repository keeps of a full run: outputs of this code, small, without widgets."""

import nbformat
import pytest

from mmqa_lab.run.store import LARGEST_BYTES, code_hash, store
from mmqa_lab.studies import STUDIES, notebooks_folder


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_stored_outputs_are_of_this_code(study):
    notebook = nbformat.read(study.path, as_version=4)
    outputs = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    if not outputs:
        pytest.skip("needs the outputs of a full run")
    assert notebook.metadata["mmqa_lab"]["code"] == code_hash(notebook)
    assert study.path.stat().st_size <= LARGEST_BYTES
    assert not any(one.get("name") == "stderr" or one.output_type == "error" for one in outputs)
    assert not any("widget" in kind for one in outputs for kind in one.get("data", {}))
    thumbnail = notebooks_folder() / "thumbnails" / f"{study.notebook}.png"
    assert thumbnail.stat().st_size <= 40_000


def test_a_quick_run_is_not_stored(tmp_path):
    with pytest.raises(ValueError, match="Must be of a full run"):
        store(tmp_path, tmp_path, STUDIES[:1])
