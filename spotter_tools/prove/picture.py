"""Draws a failed drive: the positions over time, and the speed, limit, gap and states over time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from spotter_sim.model import WorldState
from spotter_sim.solids import KINDS, Solids
from spotter_sim.view import outline_points
from spotter_tools.plots.paper import LEVEL_COLOURS, STATE_COLOURS, new_figure, save
from spotter_tools.prove.case import BEGINS_S, OUT
from spotter_tools.prove.ground import Result
from spotter_tools.prove.loop import WATCH_S, Drive, Moment
from spotter_tools.prove.table import sentence

_SENSORS = ("lidar", "radar", "camera")
_SHOWN_M = 12.0
_GHOSTS = 6  # outlines over time


def draw(drive: Drive, result: Result, folder: Path) -> Path:
    """Write the picture; its name follows from the case's."""
    figure = new_figure(13.0, 6.5)
    figure.suptitle(f"{result.name}   ({result.preset})\n{sentence(result)}", fontsize=11)
    plan, times = figure.subplots(1, 2, width_ratios=[1.0, 1.1])
    log = [moment for moment in drive.log if moment.t_s >= BEGINS_S - 1.0]
    _draw_plan(plan, drive, log)
    _draw_times(times, log, result)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{re.sub(r'[^a-z0-9.]+', '-', result.name.lower()).strip('-')}.png"
    save(figure, path)
    return path


def _draw_plan(axes: Any, drive: Drive, log: list[Moment]) -> None:
    """From above, map frame: what stands, bodies and vehicle fading in with time, the way coloured by the verdict."""
    last = drive.scenario.at(log[-1].t_s)
    near = last.solids_near(last.T_map_vehicle[:3, 3], _SHOWN_M)
    for outline in _outlines(near.take((near.owner < 0) & (near.kind != KINDS.index("ground")))):
        axes.fill(*outline.T, color="#9aa5af", lw=0)
    times = np.linspace(log[0].t_s, log[-1].t_s, _GHOSTS)
    for i, t_s in enumerate(times):
        world = drive.scenario.at(float(t_s))
        strength = 0.15 + 0.85 * (i / (_GHOSTS - 1)) ** 2
        for actor in world.actors:
            for outline in _outlines(actor.solids):
                axes.fill(*outline.T, color="#0b63b5", alpha=0.35 * strength, lw=0)
        axes.plot(*_vehicle_outline(world).T, color="black", alpha=strength, lw=1.2)
        axes.annotate(f"{t_s - BEGINS_S:.1f} s", _vehicle_outline(world)[0], fontsize=7, alpha=strength)
    for moment in log[::3]:
        level = "SAFE" if moment.verdict is None else moment.verdict.level
        axes.plot(moment.x_m, moment.y_m, ".", ms=4, color=LEVEL_COLOURS[level])
    x, y = last.T_map_vehicle[:2, 3]
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(x - 8.0, x + 5.0), ylim=(y - 5.5, y + 5.5))
    axes.set_title("grey: what stands; blue: bodies; black: the vehicle; dots: the verdict on its way", fontsize=8)
    axes.grid(alpha=0.3)


def _outlines(solids: Solids) -> list[np.ndarray]:
    """Convex outlines seen from above, each (K, 2)."""
    hulls = [cv2.convexHull(outline_points(solids, i)[:, :2].astype(np.float32)) for i in range(len(solids))]
    return [np.asarray(hull)[:, 0] for hull in hulls]


def _vehicle_outline(world: WorldState) -> np.ndarray:
    length, width, _ = world.chassis.size_m
    corners = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width], [length, width]])
    return np.asarray(corners @ world.T_map_vehicle[:2, :2].T + world.T_map_vehicle[:2, 3])


def _draw_times(axes: Any, log: list[Moment], result: Result) -> None:
    """Speed, limit and gap over time, and below them a bar for the verdict and for each sensor."""
    t = np.array([moment.t_s for moment in log]) - BEGINS_S
    limits = [np.nan if m.decision is None or m.t_s < BEGINS_S else m.decision.limit_mps for m in log]
    top = max(1.0, 1.15 * max(moment.planned_mps for moment in log))
    axes.plot(t, [moment.planned_mps for moment in log], color="#9aa5af", label="speed without brakes, m/s")
    axes.plot(t, [moment.speed_mps for moment in log], color="black", label="speed, m/s")
    axes.plot(t, np.minimum(limits, top), color="#c8102e", lw=0.9, ls="--", label="the gate's limit, m/s")
    axes.plot(t, [min(moment.gap_m, top) for moment in log], color="#0b63b5", label="gap to the nearest thing, m")
    rows = ("verdict", *_SENSORS)
    for row, name in enumerate(rows):
        y = -0.12 * top * (row + 1)
        colours = [_colour(moment, name) for moment in log]
        axes.barh([y] * len(t), WATCH_S * 1.05, 0.07 * top, t, color=colours, align="center", lw=0)
        axes.text(t[0], y, f"{name} ", ha="right", va="center", fontsize=8)
    known = result.yardstick.known_s
    for at_s, words in ((known, "a perfect sensor knows"), (result.yardstick.contact_s, "contact without brakes")):
        if at_s is not None:
            axes.axvline(at_s - BEGINS_S, color="#5c6873", lw=0.8, ls=":")
            axes.text(at_s - BEGINS_S, top, f" {words}", rotation=90, va="top", fontsize=7)
    _note_reasons(axes, log, top)
    out = f", out: {', '.join(OUT[result.out])}" if OUT[result.out] else ""
    axes.set(xlabel="s since the gate has the brakes", ylim=(-0.12 * top * (len(rows) + 0.8), top * 1.02), yticks=[])
    axes.set_yticks(np.arange(0.0, top, max(0.5, round(top / 6))))
    axes.set_title(f"green SAFE or nothing near, amber CAUTION, red IMMINENT, grey nothing said{out}", fontsize=8)
    axes.legend(loc="upper left", fontsize=7)
    axes.grid(alpha=0.3)


def _colour(moment: Moment, name: str) -> str:
    verdict = moment.verdict
    if verdict is None:
        return STATE_COLOURS["starting"]
    if name == "verdict":
        return LEVEL_COLOURS[verdict.level]
    said = verdict.inputs.get(name)
    if said is None or said.state == "disconnected":
        return STATE_COLOURS["starting"]
    return LEVEL_COLOURS[said.level or "SAFE"]


def _note_reasons(axes: Any, log: list[Moment], top: float) -> None:
    """The first sentence of every new level."""
    before, row = "", 0
    for moment in log:
        level = "" if moment.verdict is None else moment.verdict.level
        if level != before and moment.verdict is not None and row < 8:
            words = f"{moment.t_s - BEGINS_S:.2f} s {level}: {moment.verdict.because}"[:90]
            axes.text(
                0.01, 0.74 - 0.035 * row, words, transform=axes.transAxes, fontsize=6.5, color=LEVEL_COLOURS[level]
            )
            row += 1
        before = level
