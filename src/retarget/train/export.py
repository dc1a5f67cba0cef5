"""Networks written as ONNX: weights in half precision, arithmetic in single, and what they are in the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

OPSET = 17


class Graph:
    """Collects the nodes of a network that maps rows of features to rows of numbers."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []
        self.count = 0

    def apply(self, operator: str, inputs: Sequence[str], **attributes: object) -> str:
        """A node; returns the name of its result."""
        self.count += 1
        name = f"x{self.count}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def weight(self, values: np.ndarray) -> str:
        """A constant, stored as halves; returns the name of its single precision copy."""
        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(values.astype(np.float16), name))
        return self.apply("Cast", [name], to=TensorProto.FLOAT)

    def linear(self, layer: nn.Linear, x: str) -> str:
        """A linear layer."""
        weight, bias = (each.detach().numpy() for each in (layer.weight, layer.bias))
        return self.apply("Gemm", [x, self.weight(weight), self.weight(bias)], transB=1)

    def norm(self, layer: nn.LayerNorm, x: str) -> str:
        """A layer normalisation over the last axis."""
        scale, shift = (each.detach().numpy() for each in (layer.weight, layer.bias))
        return self.apply("LayerNormalization", [x, self.weight(scale), self.weight(shift)], epsilon=layer.eps, axis=-1)

    def save(self, path: Path, result: str, inputs: int, outputs: int, told: Mapping[str, str]) -> None:
        """Write the file whole or not at all."""
        self.nodes.append(helper.make_node("Identity", [result], ["out"]))
        graph = helper.make_graph(
            self.nodes, told["network"],
            [helper.make_tensor_value_info("features", TensorProto.FLOAT, ["rows", inputs])],
            [helper.make_tensor_value_info("out", TensorProto.FLOAT, ["rows", outputs])],
            self.weights,
        )  # fmt: skip
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="retarget")
        model.ir_version = 8
        helper.set_model_props(model, {**told, "made with": f"torch {torch.__version__}, onnx {onnx.__version__}"})
        onnx.checker.check_model(model)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(model.SerializeToString(deterministic=True))
        part.rename(path)


def save_reference(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """The weights of a network of `evaluate/reference`, which stays torch's own, under the network's name: `paper-skr.pt`."""
    folder.mkdir(parents=True, exist_ok=True)
    torch.save({"weights": network.state_dict(), **told}, folder / f"{told['network']}.pt")
