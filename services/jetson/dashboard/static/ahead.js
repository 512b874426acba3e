// The corridor ahead of the vehicle: x forward is up, y left is left. Lidar returns, lanes, alarm lines, radar tracks.
import { prepare, LEVEL_COLOURS, list } from "/static/canvas.js";

const AHEAD_M = 6.2;
const ALARM_LINES_M = [[0.8, "imminent-text"], [1.8, "caution-text"]];

export function drawAhead(scan, zones, radar) {
  const { pen, width, height, colour } = prepare("ahead");
  const perMetre = (height - 30) / AHEAD_M;
  const at = (x, y) => [width / 2 - y * perMetre, height - 22 - x * perMetre];

  pen.strokeStyle = colour("line");
  pen.fillStyle = colour("soft");
  for (let range = 1; range <= 6; range += 1) {
    pen.beginPath();
    pen.arc(...at(0, 0), range * perMetre, -Math.PI * 0.8, -Math.PI * 0.2);
    pen.stroke();
    pen.fillText(`${range} m`, at(range, 0)[0] + 4, at(range, 0)[1] - 3);
  }
  for (const [range, name] of ALARM_LINES_M) {
    pen.strokeStyle = colour(name);
    pen.setLineDash([6, 4]);
    pen.beginPath();
    pen.arc(...at(0, 0), range * perMetre, -Math.PI / 2 - 0.35, -Math.PI / 2 + 0.35);
    pen.stroke();
    pen.setLineDash([]);
  }
  drawScan(pen, colour, at, scan);
  drawRadar(pen, colour, at, radar, perMetre);
  pen.fillStyle = colour("text");
  const [x, y] = at(0, 0);
  pen.beginPath(); pen.moveTo(x, y - 12); pen.lineTo(x - 8, y + 8); pen.lineTo(x + 8, y + 8); pen.fill();
  describe(zones, radar);
}

function drawScan(pen, colour, at, scan) {
  if (!scan) return;
  const angles = list(scan.message.angles_rad);
  const ranges = list(scan.message.ranges_m);
  const used = list(scan.message.used);
  pen.globalAlpha = scan.ageMs > 500 ? 0.25 : 1;
  for (let i = 0; i < angles.length; i += 1) {
    if (!(ranges[i] > 0)) continue;
    const [x, y] = at(ranges[i] * Math.cos(angles[i]), ranges[i] * Math.sin(angles[i]));
    pen.fillStyle = used.length && used[i] ? colour("text") : colour("soft");
    pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  pen.globalAlpha = 1;
}

function drawRadar(pen, colour, at, radar, perMetre) {
  if (!radar) return;
  pen.globalAlpha = radar.ageMs > 500 ? 0.25 : 1;
  for (const track of radar.message.tracks) {
    const azimuth = track.azimuth_rad ?? 0;
    const [x, y] = at(track.range_m * Math.cos(azimuth), track.range_m * Math.sin(azimuth));
    pen.strokeStyle = colour(LEVEL_COLOURS[track.level]);
    pen.fillStyle = pen.strokeStyle;
    pen.lineWidth = 2.5;
    pen.beginPath(); pen.arc(x, y, 9, 0, 2 * Math.PI); pen.stroke();
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(x, y - track.velocity_mps * perMetre * 0.5); pen.stroke();
    const ttc = track.ttc_s === null ? "" : `, ${track.ttc_s.toFixed(1)} s`;
    pen.fillText(`#${track.track_id} ${track.velocity_mps.toFixed(1)} m/s${ttc}`, x + 13, y + 4);
    pen.lineWidth = 1;
  }
  pen.globalAlpha = 1;
}

function describe(zones, radar) {
  const parts = [];
  if (zones) {
    for (const name of ["left", "centre", "right"]) {
      const zone = zones.message[name];
      parts.push(`${name} ${zone.nearest_m === null ? "free" : zone.nearest_m.toFixed(2) + " m"}`);
    }
  }
  if (radar) parts.push(`${radar.message.tracks.length} radar track${radar.message.tracks.length === 1 ? "" : "s"}`);
  document.getElementById("ahead-words").textContent = parts.join(" · ") || "no data yet";
}
