// The corridor ahead of the vehicle: x forward is up, y left is left. Lidar returns, lanes, alarm lines, radar tracks.
import { prepare, LEVEL_COLOURS, list } from "/static/canvas.js";

const AHEAD_M = 6.2;
const SCAN_STALE_MS = 500;

export function drawAhead(scan, zones, radar) {
  const { pen, width, height, colour } = prepare("ahead");
  const perMetre = (height - 30) / AHEAD_M;
  const at = (x, y) => [width / 2 - y * perMetre, height - 22 - x * perMetre];
  drawRings(pen, colour, at, perMetre);
  drawLanes(pen, colour, at, zones, perMetre);
  drawScan(pen, colour, at, scan);
  drawRadarTracks(pen, colour, at, radar, perMetre);
  pen.fillStyle = colour("text");
  const [x, y] = at(0, 0);
  pen.beginPath(); pen.moveTo(x, y - 12); pen.lineTo(x - 8, y + 8); pen.lineTo(x + 8, y + 8); pen.fill();
  describe(zones, radar);
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
  pen.globalAlpha = zones.ageMs > SCAN_STALE_MS ? 0.3 : 1;
  for (const [name, right, left] of [["left", half, outer], ["centre", -half, half], ["right", -outer, -half]]) {
    const level = zones.message[name].level;
    const [x0, y0] = at(layout.look_ahead_m, left);
    const [x1, y1] = at(0, right);
    pen.fillStyle = level === "SAFE" ? "transparent" : colour(level.toLowerCase());
    pen.globalAlpha *= 0.35;
    pen.fillRect(x0, y0, x1 - x0, y1 - y0);
    pen.globalAlpha /= 0.35;
    pen.strokeStyle = colour("soft");
    pen.strokeRect(x0, y0, x1 - x0, y1 - y0);
  }
  for (const [range, name] of [[layout.imminent_m, "imminent-text"], [layout.caution_m, "caution-text"]]) {
    pen.strokeStyle = colour(name);
    pen.setLineDash([6, 4]);
    pen.beginPath(); pen.moveTo(...at(range, outer + 0.25)); pen.lineTo(...at(range, -outer - 0.25)); pen.stroke();
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

function describe(zones, radar) {
  const parts = [];
  if (zones && zones.ageMs > SCAN_STALE_MS) parts.push(`lidar stale for ${(zones.ageMs / 1000).toFixed(1)} s`);
  else if (zones) {
    for (const name of ["left", "centre", "right"]) {
      const zone = zones.message[name];
      parts.push(`${name} ${zone.nearest_m === null ? "free" : zone.nearest_m.toFixed(2) + " m"}`);
    }
  }
  if (radar) parts.push(`${radar.message.tracks.length} radar track${radar.message.tracks.length === 1 ? "" : "s"}`);
  const text = parts.join(" · ") || "no data yet";
  const words = document.getElementById("ahead-words");
  if (words.textContent !== text) words.textContent = text;
}
