"""From a backbone to a model that labels as was shown."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import pytest

from dream.perception import LearnedLabels
from dream.perception.sight import FEATURES
from dream.teaching.backbone import TEXTURE, open_backbone
from dream.teaching.fit import Example, HeadLesson
from dream.teaching.model import Extractor, Head, save, taught_model
from dream.types import Label
from tests.teaching.lessons import save_sight, save_tokens, scene, strokes


def opened(path: Path) -> Extractor:
    return Extractor(open_backbone(path))


def backbones(folder: Path) -> dict[str, Path]:
    (folder / "v3.json").write_text('{"height": 224, "width": 320, "patch": 16}')
    return {
        "texture": Path(TEXTURE),
        "sight": save_sight(folder / "sight.onnx"),
        "v2": save_tokens(folder / "v2.onnx"),
        "v3": save_tokens(folder / "v3.onnx", patch=16, others=5, opset=18),
    }


@pytest.mark.parametrize("name", ["texture", "sight", "v2", "v3"])
def test_the_model_labels_as_was_shown(tmp_path: Path, name: str) -> None:
    extractor = opened(backbones(tmp_path)[name])
    taught = [scene(n) for n in range(4)]
    examples = [
        Example.of(str(n), extractor.cells(rgb), strokes(truth)) for n, (rgb, truth) in enumerate(taught)
    ]
    found = HeadLesson(examples, extractor.backbone.channels).measured(extractor)
    assert found is not None
    save(tmp_path / "shell.onnx", extractor, found.head, "shell", {"target": "shell"})
    labels = LearnedLabels(tmp_path / "shell.onnx")
    for number, size in ((10, (240, 320)), (11, (480, 600)), (12, (150, 333))):
        rgb, truth = scene(number, size)
        shown = extractor.target(found.head.logits(extractor.cells(rgb)), extractor.frame(rgb.shape), size)
        told, confidence = labels.segment(rgb)
        np.testing.assert_array_equal(told == Label.TARGET, shown)
        assert confidence.min() >= 0.5
        if name in ("texture", "sight"):
            assert (shown & truth).sum() / (shown | truth).sum() > 0.8
    sidecar = json.loads((tmp_path / "shell.json").read_text())
    assert sidecar["classes"] == {"shell": "target"}
    assert json.loads((tmp_path / "shell.card.json").read_text()) == {"target": "shell"}


def test_what_the_head_does_not_need_is_left_out(tmp_path: Path) -> None:
    extractor = opened(save_sight(tmp_path / "sight.onnx"))
    model = onnx.load_model_from_string(taught_model(extractor, Head(np.ones(6 + 26), 0.0)))
    assert [one.name for one in model.graph.input] == ["picture"]
    assert [one.name for one in model.graph.output] == ["target"]
    made = {name for node in model.graph.node for name in node.output}
    assert FEATURES in made
    assert not made & {"labels", "depth"}
    assert not {one.name for one in model.graph.initializer} & {"d", "l"}
    onnx.checker.check_model(model, full_check=True)


def test_the_unknown_view_is_zero(tmp_path: Path) -> None:
    extractor = opened(save_sight(tmp_path / "sight.onnx"))
    rgb, _ = scene(1)
    import onnxruntime

    whole = onnxruntime.InferenceSession(tmp_path / "sight.onnx", providers=["CPUExecutionProvider"])
    x = (rgb.transpose(2, 0, 1)[None] / 255.0).astype(np.float32)
    (wanted,) = whole.run([FEATURES], {"picture": x, "view": np.zeros_like(x)})
    np.testing.assert_allclose(extractor.cells(rgb)[:6], wanted[0], atol=1e-5)


def test_class_and_register_tokens_are_dropped(tmp_path: Path) -> None:
    # The tokens before the patches are a hundred times as large.
    for name in ("v2", "v3"):
        extractor = opened(backbones(tmp_path)[name])
        assert np.abs(extractor.cells(scene(1)[0])[:8]).max() < 50.0
    assert opened(tmp_path / "v2.onnx").backbone.size == (336, 448)
    assert opened(tmp_path / "v2.onnx").backbone.grid == (24, 32)
    assert opened(tmp_path / "v3.onnx").backbone.grid == (14, 20)


def test_brightness_and_hues_hardly_change_with_all_of_the_light() -> None:
    extractor = opened(Path(TEXTURE))
    rgb = np.clip(scene(1)[0], 100, 255)
    whole = extractor.cells(rgb)
    half = extractor.cells((rgb.astype(float) * 0.5).astype(np.uint8))
    assert np.abs(whole[:3] - half[:3]).max() < 0.1 * np.ptp(whole[0])
    assert np.abs(whole.mean(axis=(1, 2))).max() < 1e-3


@pytest.mark.parametrize(
    ("card", "words"),
    [
        ('{"patch": 15}', "fit no patches of 15"),
        ('{"output": "pooled"}', "output: expected one of last_hidden_state, got pooled"),
        ('{"height": 4}', "height"),
        ('{"heigth": 224}', "heigth"),
        ('{"features": "grid"}', "height: the network takes any"),
        ("no JSON", "all of it"),
    ],
)
def test_a_card_that_does_not_fit_is_refused(tmp_path: Path, card: str, words: str) -> None:
    path = save_tokens(tmp_path / "v2.onnx")
    path.with_suffix(".json").write_text(card)
    with pytest.raises(ValueError, match=words):
        open_backbone(path)


def test_files_that_are_no_backbone_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(ValueError, match="ONNX"):
        open_backbone(tmp_path / "text.onnx")
    with pytest.raises(ValueError, match="expected a readable file"):
        open_backbone(tmp_path / "nowhere.onnx")
    with pytest.raises(ValueError, match="expected opset 11 or later, got 10"):
        open_backbone(save_tokens(tmp_path / "old.onnx", opset=10))
