// The corridor ahead of the vehicle: x forward is up, y left is left. Lidar returns, lanes, alarm lines, radar tracks.
import { prepare, LEVEL_COLOURS, list } from "/static/canvas.js";
import { ageWords } from "/static/store.js";

const AHEAD_M = 6.2;
const SCAN_STALE_MS = 500;

export function drawAhead(scan, zones, radar, verdict) {
  const { pen, width, height, colour } = prepare("ahead");
  const perMetre = (height - 30) / AHEAD_M;
  const at = (x, y) => [width / 2 - y * perMetre, height - 22 - x * perMetre];
  drawRings(pen, colour, at, perMetre);
  drawWay(pen, colour, at, verdict);
  drawLanes(pen, colour, at, zones, perMetre);
  drawScan(pen, colour, at, scan);
  drawRadarTracks(pen, colour, at, radar, perMetre);
  pen.fillStyle = colour("text");
  const [x, y] = at(0, 0);
  pen.beginPath(); pen.moveTo(x, y - 12); pen.lineTo(x - 8, y + 8); pen.lineTo(x + 8, y + 8); pen.fill();
  describe(zones, radar, verdict);
}

// A place along the way: ahead of the bumper and beside the track of the vehicle's origin, to x and y.
export function along(curvature, ahead, beside) {
  if (Math.abs(curvature) < 1e-6) return [ahead, beside];
  const radius = 1 / Math.abs(curvature);
  const side = Math.sign(curvature);
  const distance = radius - side * beside;
  return [distance * Math.sin(ahead / radius), side * (radius - distance * Math.cos(ahead / radius))];
}

// The way that the vehicle will pass: seen free, and not seen (hatched), up to where it would stop.
function drawWay(pen, colour, at, verdict) {
  const message = verdict && verdict.ageMs < SCAN_STALE_MS ? verdict.message : null;
  const way = message && message.way;
  if (!way || message.covered_m === null) return;
  const end = Math.min(AHEAD_M, Math.max(way.stopping_m, 3));
  const strip = (from, to) => {
    const steps = Array.from({ length: 13 }, (_, i) => from + ((to - from) * i) / 12);
    pen.beginPath();
    for (const s of steps) pen.lineTo(...at(...along(way.curvature_per_m, s, way.left_m)));
    for (const s of steps.reverse()) pen.lineTo(...at(...along(way.curvature_per_m, s, -way.right_m)));
    pen.closePath();
  };
  const seen = Math.min(message.covered_m, end);
  if (seen > 0) {
    strip(0, seen);
    pen.fillStyle = colour("safe");
    pen.globalAlpha = 0.25;
    pen.fill();
    pen.globalAlpha = 1;
  }
  pen.strokeStyle = colour("caution-text");
  pen.setLineDash([2, 3]);
  for (const gap of message.uncovered) {
    if (gap.from_m >= end) continue;
    strip(gap.from_m, Math.min(gap.to_m, end));
    pen.stroke();
  }
  pen.setLineDash([]);
  if (way.stopping_m > 0 && way.stopping_m <= AHEAD_M) {
    pen.strokeStyle = colour("text");
    pen.beginPath();
    pen.moveTo(...at(...along(way.curvature_per_m, way.stopping_m, way.left_m + 0.15)));
    pen.lineTo(...at(...along(way.curvature_per_m, way.stopping_m, -way.right_m - 0.15)));
    pen.stroke();
  }
}

function drawRings(pen, colour, at, perMetre) {
  pen.strokeStyle = colour("line");
  pen.fillStyle = colour("soft");
  for (let range = 1; range <= 6; range += 1) {
    pen.beginPath();
    pen.arc(...at(0, 0), range * perMetre, -Math.PI * 0.8, -Math.PI * 0.2);
    pen.stroke();
    const [x, y] = at(range * Math.cos(0.62), -range * Math.sin(0.62));
    pen.fillText(`${range} m`, Math.min(x + 4, at(0, 0)[0] * 2 - 26), y + 4);
  }
}

function drawLanes(pen, colour, at, zones, perMetre) {
  const layout = zones && zones.message.layout;
  if (!layout) return;
  const half = layout.centre_width_m / 2;
  const outer = half + layout.side_width_m;
  const curvature = layout.curvature_per_m ?? 0;
  pen.globalAlpha = zones.ageMs > SCAN_STALE_MS ? 0.3 : 1;
  for (const [name, right, left] of [["left", half, outer], ["centre", -half, half], ["right", -outer, -half]]) {
    const level = zones.message[name].level;
    const end = Math.min(layout.look_ahead_m, AHEAD_M);
    const steps = Array.from({ length: curvature ? 13 : 2 }, (_, i, n = curvature ? 12 : 1) => (end * i) / n);
    pen.beginPath();
    for (const s of steps) pen.lineTo(...at(...along(curvature, s, left)));
    for (const s of steps.reverse()) pen.lineTo(...at(...along(curvature, s, right)));
    pen.closePath();
    pen.fillStyle = level === "SAFE" ? "transparent" : colour(level.toLowerCase());
    pen.globalAlpha *= 0.35;
    pen.fill();
    pen.globalAlpha /= 0.35;
    pen.strokeStyle = colour("soft");
    pen.stroke();
  }
  for (const [range, name] of [[layout.imminent_m, "imminent-text"], [layout.caution_m, "caution-text"]]) {
    if (range > AHEAD_M) continue;
    pen.strokeStyle = colour(name);
    pen.setLineDash([6, 4]);
    pen.beginPath();
    pen.moveTo(...at(...along(curvature, range, outer + 0.25)));
    pen.lineTo(...at(...along(curvature, range, -outer - 0.25)));
    pen.stroke();
    pen.setLineDash([]);
  }
  pen.globalAlpha = 1;
}

function drawScan(pen, colour, at, scan) {
  if (!scan) return;
  const angles = list(scan.message.angles_rad);
  const ranges = list(scan.message.ranges_m);
  const used = list(scan.message.used);
  const plain = colour("soft");
  const kept = colour("text");
  pen.globalAlpha = scan.ageMs > SCAN_STALE_MS ? 0.25 : 1;
  for (let i = 0; i < angles.length; i += 1) {
    if (!(ranges[i] > 0)) continue;
    const [x, y] = at(ranges[i] * Math.cos(angles[i]), ranges[i] * Math.sin(angles[i]));
    pen.fillStyle = used.length && used[i] ? kept : plain;
    pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  pen.globalAlpha = 1;
}

function drawRadarTracks(pen, colour, at, radar, perMetre) {
  if (!radar) return;
  pen.globalAlpha = radar.ageMs > SCAN_STALE_MS ? 0.25 : 1;
  for (const track of radar.message.tracks) {
    const azimuth = track.azimuth_rad ?? 0;
    const [x, y] = at(track.range_m * Math.cos(azimuth), track.range_m * Math.sin(azimuth));
    pen.strokeStyle = colour(LEVEL_COLOURS[track.level]);
    pen.fillStyle = pen.strokeStyle;
    pen.lineWidth = 2.5;
    pen.beginPath(); pen.arc(x, y, 9, 0, 2 * Math.PI); pen.stroke();
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x, y - track.velocity_mps * perMetre * 0.5); pen.stroke();
    pen.fillText(`#${track.track_id}`, x + 13, y + 4);
    pen.lineWidth = 1;
  }
  pen.globalAlpha = 1;
}

function describe(zones, radar, verdict) {
  const parts = [];
  if (zones && zones.ageMs > SCAN_STALE_MS) parts.push(`LiDAR stale: ${ageWords(zones.ageMs)} old`);
  else if (zones) {
    for (const name of ["left", "centre", "right"]) {
      const zone = zones.message[name];
      parts.push(`${name} ${zone.nearest_m === null ? "free" : zone.nearest_m.toFixed(2) + " m"}`);
    }
  }
  if (radar && radar.ageMs > SCAN_STALE_MS) parts.push(`radar stale: ${ageWords(radar.ageMs)} old`);
  else if (radar) parts.push(`${radar.message.tracks.length} radar track${radar.message.tracks.length === 1 ? "" : "s"}`);
  const covered = verdict ? verdict.message.covered_m : null;
  if (covered !== null && covered !== undefined) parts.push(`way seen ${covered.toFixed(1)} m ahead`);
  const text = parts.join(" · ") || "no data yet";
  const words = document.getElementById("ahead-words");
  if (words.textContent !== text) words.textContent = text;
}
