"""Files of models: what is let in, and what is refused for which reason."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from dream.extras import missing
from dream.perception import onnx as ours
from dream.perception.onnx import Network, checked_bytes, contents
from tests.perception.models import constant, redness, save


def test_a_model_runs_on_a_picture(tmp_path: Path) -> None:
    network = Network(redness(tmp_path / "m.onnx", gain=1.0))
    x = np.zeros((1, 3, 24, 32), np.float32)
    x[0, 0] = 0.5
    (scores,) = network.run(x, ["scores"])
    assert network.input_shape == (1, 3, 24, 32)
    np.testing.assert_allclose(scores[0, :, 3, 4], [0.0, 0.15, -1.12])


def test_what_a_file_holds_is_what_the_onnx_package_reads(tmp_path: Path) -> None:
    model = onnx.load(redness(tmp_path / "m.onnx"))
    found = contents(model.SerializeToString())
    assert dict(found.opsets) == {"": 17}
    assert found.nodes == len(model.graph.node)
    assert found.external == 0


def external(name: str) -> TensorProto:
    tensor = numpy_helper.from_array(np.zeros(4, np.float32), name)
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    return tensor


def test_weights_in_other_files_are_refused_wherever_they_hide(tmp_path: Path) -> None:
    info = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 8, 8])
    out = helper.make_tensor_value_info("y", TensorProto.FLOAT, [4])
    branch = helper.make_graph(
        [helper.make_node("Constant", [], ["z"], value=external("inner"))],
        "branch",
        [],
        [helper.make_tensor_value_info("z", TensorProto.FLOAT, [4])],
    )
    graphs = (
        helper.make_graph([helper.make_node("Identity", ["w"], ["y"])], "g", [info], [out], [external("w")]),
        helper.make_graph([helper.make_node("Constant", [], ["y"], value=external("w"))], "g", [info], [out]),
        helper.make_graph(
            [helper.make_node("If", ["c"], ["y"], then_branch=branch, else_branch=branch)],
            "g",
            [info],
            [out],
            [numpy_helper.from_array(np.array(True), "c")],
        ),
    )
    models = [helper.make_model(graph) for graph in graphs]
    plain = helper.make_graph([helper.make_node("Identity", ["images"], ["y"])], "g", [info], [out])
    body = [helper.make_node("Constant", [], ["y"], value=external("w"))]
    function = helper.make_function("", "f", [], ["y"], body, [helper.make_opsetid("", 17)])
    models.append(helper.make_model(plain, functions=[function]))
    models.append(helper.make_model(plain))
    models[-1].training_info.add().algorithm.initializer.append(external("w"))
    for model in models:
        path = tmp_path / "m.onnx"
        path.write_bytes(model.SerializeToString())
        with pytest.raises(ValueError, match="tensors in other files"):
            checked_bytes(path)


def test_operators_of_others_and_old_opsets_are_refused(tmp_path: Path) -> None:
    model = onnx.load(redness(tmp_path / "m.onnx"))
    model.opset_import.append(helper.make_opsetid("evil.example", 1))
    (tmp_path / "a.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match=r"standard operators, got those of 'evil.example'"):
        checked_bytes(tmp_path / "a.onnx")
    del model.opset_import[1]
    model.opset_import[0].version = 3
    (tmp_path / "b.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match="opset 7 to 30, got 3"):
        checked_bytes(tmp_path / "b.onnx")


def test_files_that_are_too_large_or_not_there_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = redness(tmp_path / "m.onnx")
    with pytest.raises(ValueError, match="expected a readable file"):
        checked_bytes(tmp_path / "other.onnx")
    monkeypatch.setattr(ours, "MOST_BYTES", 100)
    with pytest.raises(ValueError, match="model: expected at most"):
        checked_bytes(path)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path: Path) -> None:
    whole = redness(tmp_path / "m.onnx").read_bytes()
    path = tmp_path / "cut.onnx"
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        with pytest.raises(ValueError, match="model"):
            Network(path)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_a_model_or_refused_with_a_reason(raw: bytes) -> None:
    try:
        contents(raw)
    except ValueError as error:
        assert str(error).startswith("model: ")  # noqa: PT017 - either is right


def test_graphs_within_graphs_without_end_are_refused() -> None:
    def wrapped(number: int, inner: bytes) -> bytes:
        length, size = b"", len(inner)
        while size > 127:
            length, size = length + bytes([size & 127 | 128]), size >> 7
        return bytes([number << 3 | 2]) + length + bytes([size]) + inner

    graph = b""
    for _ in range(100):  # graph > node > attribute > graph
        graph = wrapped(1, wrapped(5, wrapped(6, graph)))
    with pytest.raises(ValueError, match="graphs within each other"):
        contents(wrapped(7, graph))


def test_inputs_that_are_no_picture_are_refused(tmp_path: Path) -> None:
    node = helper.make_node("Identity", ["images"], ["y"])
    flat = save(tmp_path / "a.onnx", [node], {}, [1, 9], {"y": [1, 9]})
    with pytest.raises(ValueError, match="one picture in 4 dimensions"):
        Network(flat)
    many = save(tmp_path / "b.onnx", [node], {}, [2, 3, 8, 8], {"y": [2, 3, 8, 8]})
    with pytest.raises(ValueError, match="one picture in 4 dimensions"):
        Network(many)
    cast = helper.make_node("Cast", ["images"], ["y"], to=TensorProto.FLOAT)
    whole_in = save(
        tmp_path / "c.onnx", [cast], {}, [1, 3, 8, 8], {"y": [1, 3, 8, 8]}, kind=TensorProto.INT64
    )
    with pytest.raises(ValueError, match=r"tensor\(uint8\), got images: tensor\(int64\)"):
        Network(whole_in)


def test_answers_come_as_they_are(tmp_path: Path) -> None:
    network = Network(constant(tmp_path / "m.onnx", np.array([[1.0, np.nan], [1.0, np.inf]])))
    (depth,) = network.run(np.zeros((1, 3, 24, 32), np.float32), ["depth"])
    np.testing.assert_array_equal(depth[0, 0], [[1.0, np.nan], [1.0, np.inf]])


def test_a_picture_of_the_wrong_size_is_refused(tmp_path: Path) -> None:
    network = Network(redness(tmp_path / "m.onnx"))
    with pytest.raises(ValueError, match=r"fails on \(1, 3, 8, 8\)"):
        network.run(np.zeros((1, 3, 8, 8), np.float32), ["scores"])


def test_threads_are_few(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="threads: expected 1 to 8"):
        Network(redness(tmp_path / "m.onnx"), threads=0)


def test_without_the_extra_the_reason_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=re.escape(missing("rov", "onnxruntime", "model"))):
        Network(redness(tmp_path / "m.onnx"))
