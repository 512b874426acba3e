// What the pole sees, in the map frame: boxes with class, id, velocity.
import { prepare } from "/static/canvas.js";

const COLOURS = { car: "#4da3ff", large_vehicle: "#b58cff", cyclist: "#ffb84d", pedestrian: "#5fd38d", background: "#8a97a3", unknown: "#ff7b7b" };
const MARGIN_M = 6;
const view = { minX: -20, maxX: 40, minY: -20, maxY: 20 };

export function drawRoadside(tracks, ego) {
  const { pen, width, height, colour } = prepare("roadside");
  if (!tracks) return;
  for (const track of tracks.message.tracks) grow(track.position_m);
  const perMetre = Math.min(width / (view.maxX - view.minX), height / (view.maxY - view.minY));
  const at = (x, y) => [
    width / 2 + (x - (view.minX + view.maxX) / 2) * perMetre,
    height / 2 - (y - (view.minY + view.maxY) / 2) * perMetre,
  ];
  pen.strokeStyle = colour("line");
  for (let x = Math.ceil(view.minX / 10) * 10; x <= view.maxX; x += 10) line(pen, at(x, view.minY), at(x, view.maxY));
  for (let y = Math.ceil(view.minY / 10) * 10; y <= view.maxY; y += 10) line(pen, at(view.minX, y), at(view.maxX, y));
  pen.globalAlpha = tracks.ageMs > 500 ? 0.3 : 1;
  for (const track of tracks.message.tracks) drawTrack(pen, colour, at, perMetre, track);
  if (ego && ego.message.T_map_vehicle) {
    const T = ego.message.T_map_vehicle;
    const [x, y] = at(T[0][3], T[1][3]);
    pen.fillStyle = colour("text");
    pen.fillRect(x - 4, y - 4, 8, 8);
    pen.fillText("vehicle", x + 7, y + 4);
  }
  pen.globalAlpha = 1;
  const counts = {};
  for (const track of tracks.message.tracks) counts[track.label] = (counts[track.label] ?? 0) + 1;
  const words = Object.entries(counts).map(([label, n]) => `${n} ${label.replace("_", " ")}`).join(", ") || "nobody";
  document.getElementById("roadside-words").textContent = tracks.ageMs > 500 ? `stale for ${(tracks.ageMs / 1000).toFixed(1)} s` : words;
}

function grow([x, y]) {
  view.minX = Math.min(view.minX, x - MARGIN_M);
  view.maxX = Math.max(view.maxX, x + MARGIN_M);
  view.minY = Math.min(view.minY, y - MARGIN_M);
  view.maxY = Math.max(view.maxY, y + MARGIN_M);
}

function line(pen, from, to) {
  pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to); pen.stroke();
}

function drawTrack(pen, colour, at, perMetre, track) {
  const [x, y] = at(track.position_m[0], track.position_m[1]);
  pen.save();
  pen.translate(x, y);
  pen.rotate(-track.yaw_rad);
  pen.strokeStyle = COLOURS[track.label] ?? COLOURS.unknown;
  pen.lineWidth = 2;
  if (track.state === "coasting") pen.setLineDash([4, 3]);
  const [length, breadth] = track.size_m;
  pen.strokeRect((-length / 2) * perMetre, (-breadth / 2) * perMetre, length * perMetre, breadth * perMetre);
  pen.restore();
  pen.strokeStyle = COLOURS[track.label] ?? COLOURS.unknown;
  line(pen, [x, y], at(track.position_m[0] + track.velocity_mps[0], track.position_m[1] + track.velocity_mps[1]));
  pen.fillStyle = colour("text");
  pen.fillText(`${track.track_id}`, x + 6, y - 6);
}
