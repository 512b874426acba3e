# /// script
# requires-python = ">=3.11"
# dependencies = ["spotter[jetson]", "torch==2.13.0", "onnx>=1.19", "onnxscript>=0.5"]
# [tool.uv.sources]
# spotter = { path = "../../.." }
# ///
"""Train the tiny demo network on simulated pictures and write it as ONNX in the YOLOv8 output layout.

    uv run --script services/jetson/camera/training/train_demo_network.py

It knows the simulated world and nothing else; on real pictures use a real network. Seeded; a few minutes on two cores.
torch is needed here only, never at run time. Anchor-free head after FCOS (Tian et al. 2019): a cell near the middle of
a box predicts its four sides; its class score is trained to follow the overlap it reaches (VarifocalNet, Zhang et al.
2021).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import onnx
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from services.jetson.camera.detector import DEMO_MODEL
from services.jetson.camera.training.training_world import Canvas, training_set

NAMES = ("person", "bicycle", "car", "bus", "truck")
CANVAS = Canvas(320, 256, NAMES)
WIDTH_PX, HEIGHT_PX, STRIDE_PX = 320, 256, 16
COLUMNS, ROWS = WIDTH_PX // STRIDE_PX, HEIGHT_PX // STRIDE_PX
POSITIVE_VISIBLE, IGNORED_VISIBLE = 0.40, 0.10
SEED = 20


# --- network --------------------------------------------------------------------------------------------------


def conv(inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """3 x 3 convolution with batch norm and activation, (B, inputs, H, W) -> (B, outputs, H / stride, W / stride)."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False), nn.BatchNorm2d(outputs), nn.SiLU()
    )


class Residual(nn.Module):
    """A bottleneck of two convolutions around which the input is added (He et al. 2016)."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.body = nn.Sequential(conv(channels, channels // 2), conv(channels // 2, channels, 1, dilation))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


class DemoNetwork(nn.Module):
    """Pictures (B, 3, 256, 320) RGB in 0..1 to raw maps (B, 4 + classes, ROWS, COLUMNS)."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(
            conv(3, 12, 2), conv(12, 24, 2), conv(24, 40, 2), Residual(40, 1), conv(40, 64, 2),
            *(Residual(64, dilation) for dilation in (1, 2, 4, 8)),
        )  # fmt: skip
        self.head = nn.Sequential(conv(64, 64), nn.Conv2d(64, 4 + len(NAMES), 1))
        nn.init.constant_(self.head[-1].bias[4:], -4.0)
        nn.init.constant_(self.head[-1].bias[:4], 1.0)

    def forward(self, x: Tensor) -> Tensor:
        return self.head(self.body(x))


def cell_centres() -> Tensor:
    """(2, ROWS, COLUMNS) x and y in input px."""
    y, x = torch.meshgrid(torch.arange(ROWS) + 0.5, torch.arange(COLUMNS) + 0.5, indexing="ij")
    return torch.stack([x, y]) * STRIDE_PX


def corners(raw: Tensor) -> Tensor:
    """Raw maps to boxes (B, 4, ROWS, COLUMNS) x1 y1 x2 y2: distances from the cell's middle to the four sides."""
    sides = F.softplus(raw[:, :4]) * STRIDE_PX
    centre = cell_centres().to(raw)
    return torch.cat([centre - sides[:, :2], centre + sides[:, 2:]], dim=1)


class Exported(nn.Module):
    """The network with its decoding: (1, 4 + classes, N), centre x, centre y, width, height, class scores."""

    def __init__(self, network: DemoNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        raw = self.network(images)
        low, high = corners(raw).chunk(2, dim=1)
        return torch.cat([(low + high) / 2, high - low, torch.sigmoid(raw[:, 4:])], dim=1).flatten(2)


# --- training -------------------------------------------------------------------------------------------------


def targets(labels: list[np.ndarray]) -> tuple[Tensor, Tensor, Tensor]:
    """Per cell: class (-1 none, -2 ignored) (B, ROWS, COLUMNS), box (B, 4, ROWS, COLUMNS).

    A cell belongs to the smallest box in whose inner half it lies; hidden actors are neither right nor wrong.
    """
    centres = cell_centres().numpy()
    classes = np.full((len(labels), ROWS, COLUMNS), -1)
    boxes = np.zeros((len(labels), 4, ROWS, COLUMNS), np.float32)
    for i, rows in enumerate(labels):
        areas = (rows[:, 3] - rows[:, 1]) * (rows[:, 4] - rows[:, 2])
        for kind, x1, y1, x2, y2, visible in rows[np.argsort(-areas)]:
            middle, half = np.array([(x1 + x2) / 2, (y1 + y2) / 2]), np.array([(x2 - x1) / 4, (y2 - y1) / 4])
            reach = np.maximum(half, 0.5 * STRIDE_PX)[:, None, None]
            inside = (np.abs(centres - middle[:, None, None]) <= reach).all(axis=0)
            small = min(x2 - x1, y2 - y1) < 5
            if visible < IGNORED_VISIBLE:
                continue
            ignored = visible < POSITIVE_VISIBLE or small
            classes[i][inside] = -2 if ignored else int(kind)
            boxes[i][:, inside] = np.array([x1, y1, x2, y2], np.float32)[:, None]
    return torch.from_numpy(classes), torch.from_numpy(boxes), torch.from_numpy(classes != -2)


def overlap(one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """IoU and generalised IoU (Rezatofighi et al. 2019) of boxes (4, N)."""
    low, high = torch.maximum(one[:2], other[:2]), torch.minimum(one[2:], other[2:])
    shared = (high - low).clamp(min=0).prod(0)
    union = (one[2:] - one[:2]).prod(0) + (other[2:] - other[:2]).prod(0) - shared
    hull = (torch.maximum(one[2:], other[2:]) - torch.minimum(one[:2], other[:2])).prod(0)
    iou = shared / union.clamp(min=1e-6)
    return iou, iou - (hull - union) / hull.clamp(min=1e-6)


def loss_of(raw: Tensor, labels: list[np.ndarray]) -> Tensor:
    """Scalar training loss of the raw outputs of a batch against its labelled boxes."""
    classes, boxes, counted = targets(labels)
    positive = classes >= 0
    score = raw[:, 4:].permute(0, 2, 3, 1)
    wanted = torch.zeros_like(score)
    box_loss = raw.sum() * 0.0
    if positive.any():
        found = corners(raw).permute(1, 0, 2, 3)[:, positive]
        iou, giou = overlap(found, boxes.permute(1, 0, 2, 3)[:, positive])
        box_loss = (1 - giou).mean()
        # The score to reach: mostly the overlap, but never so low that a found object stays silent.
        wanted[positive] = F.one_hot(classes[positive], len(NAMES)) * (0.5 + 0.5 * iou.detach().clamp(0, 1))[:, None]
    cost = F.binary_cross_entropy_with_logits(score, wanted, reduction="none")
    weight = torch.where(wanted > 0, wanted, 0.75 * torch.sigmoid(score).detach() ** 2)
    score_loss = (cost * weight * counted[..., None]).sum() / positive.sum().clamp(min=1)
    return score_loss + 2.0 * box_loss


def augmented(pictures: Tensor, labels: list[np.ndarray], rng: np.random.Generator) -> tuple[Tensor, list[np.ndarray]]:
    """Mirrored at random, with other colours and exposure."""
    pictures, labels = pictures.float() / 255, list(labels)
    for i, rows in enumerate(labels):
        if rng.random() < 0.5:
            pictures[i] = pictures[i].flip(-1)
            rows = rows.copy()
            rows[:, [1, 3]] = WIDTH_PX - rows[:, [3, 1]]
            labels[i] = rows
    tint = torch.from_numpy(rng.uniform(0.8, 1.2, (len(labels), 3, 1, 1)).astype(np.float32))
    gain = torch.from_numpy(rng.uniform(0.75, 1.2, (len(labels), 1, 1, 1)).astype(np.float32))
    return (pictures * tint * gain).clamp(0, 1), labels


def train(
    inputs: np.ndarray, labels: list[np.ndarray], steps: int, batch: int, rng: np.random.Generator
) -> DemoNetwork:
    """A network after ``steps`` batches; AdamW with one cycle of the learning rate (Smith 2018)."""
    network = DemoNetwork().to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), lr=4e-3, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=steps, pct_start=0.1)
    started_s, running = time.monotonic(), 0.0
    for step in range(steps):
        chosen = rng.integers(0, len(inputs), batch)
        pictures, boxes = augmented(torch.from_numpy(inputs[chosen]), [labels[i] for i in chosen], rng)
        loss = loss_of(network(pictures.to(memory_format=torch.channels_last)), boxes)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        schedule.step()
        running += 0.05 * (loss.item() - running) if step else loss.item()
        if step % 50 == 49:
            sys.stderr.write(f"step {step + 1}/{steps}: loss {running:.3f}, {time.monotonic() - started_s:.0f} s\n")
    return network


def export(network: DemoNetwork, path: Path) -> None:
    """ONNX with the metadata that this family of networks carries."""
    path.parent.mkdir(parents=True, exist_ok=True)
    example = torch.zeros(1, 3, HEIGHT_PX, WIDTH_PX)
    torch.onnx.export(
        Exported(network).eval(), (example,), str(path), input_names=["images"], output_names=["output0"],
        dynamo=True, external_data=False, verbose=False,
    )  # fmt: skip
    model = onnx.load(path)
    for key, value in {
        "names": repr(dict(enumerate(NAMES))),
        "task": "detect",
        "stride": str(STRIDE_PX),
        "imgsz": repr([HEIGHT_PX, WIDTH_PX]),
        "description": "Spotter demo network, trained on simulated pictures only",
        "license": "Apache-2.0",
    }.items():
        model.metadata_props.add(key=key, value=value)
    del model.graph.value_info[:]
    for node in model.graph.node:
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    onnx.save(model, path)


def main() -> None:
    """Train, export and check the network; seeded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=DEMO_MODEL)
    parser.add_argument("--scenarios", type=int, default=160)
    parser.add_argument("--pictures", type=int, default=15, help="per scenario")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch", type=int, default=12)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.manual_seed(SEED)
    torch.set_num_threads(options.threads)
    rng = np.random.default_rng(SEED)
    inputs, labels = training_set(options.scenarios, options.pictures, CANVAS, rng)
    sys.stderr.write(f"{len(inputs)} pictures, {sum(len(rows) for rows in labels)} boxes\n")
    network = train(inputs, labels, options.steps, options.batch, rng)
    export(network, options.out)
    sys.stderr.write(f"{options.out}: {options.out.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
