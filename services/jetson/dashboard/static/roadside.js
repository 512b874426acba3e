// What the pole sees, in the map frame: boxes with class, id, velocity and trail; the cloud in 3-D when asked for.
// From above x is up and y is left, as in the view ahead of the vehicle.
import { prepare, list, unit } from "/static/canvas.js";
import { ageWords } from "/static/store.js";

const STALE_MS = 500;
const TRAIL_MS = 6000;
const SLOW_MPS = 0.3;
const FIT_M = 45; // who is farther away does not shrink the view; zoom out to see them
const CLASSES = ["car", "large_vehicle", "cyclist", "pedestrian", "background", "unknown"];
const SHORT = { large_vehicle: "large", pedestrian: "ped.", cyclist: "cycl." }; // no class by colour alone
const canvas = document.getElementById("roadside");
const toggle = document.getElementById("cloud-toggle");
const trails = new Map();
const camera = { x: 10, y: 0, perMetre: 0, turn: 0.6, tilt: 0.9 };
let touched = false;

export const cloudIsOn = () => toggle.getAttribute("aria-pressed") === "true";
export function onCloudToggle(tell) {
  toggle.addEventListener("click", () => {
    const on = !cloudIsOn();
    toggle.setAttribute("aria-pressed", String(on));
    toggle.textContent = `3-D cloud: ${on ? "on" : "off"}`;
    tell();
  });
}
document.getElementById("roadside-home").addEventListener("click", () => { touched = false; });
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  touched = true;
  camera.perMetre *= event.deltaY < 0 ? 1.15 : 1 / 1.15;
}, { passive: false });
canvas.addEventListener("pointermove", (event) => {
  if (!event.buttons) return;
  touched = true;
  if (cloudIsOn()) {
    camera.turn += event.movementX * 0.01;
    camera.tilt = Math.min(1.5, Math.max(0.1, camera.tilt + event.movementY * 0.01));
  } else {
    camera.y += event.movementX / unit() / camera.perMetre;
    camera.x += event.movementY / unit() / camera.perMetre;
  }
});
canvas.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [0, 1], ArrowRight: [0, -1], ArrowUp: [1, 0], ArrowDown: [-1, 0] }[event.key];
  if (!step && event.key !== "+" && event.key !== "-") return;
  event.preventDefault();
  touched = true;
  if (step) { camera.x += (step[0] * 30) / camera.perMetre; camera.y += (step[1] * 30) / camera.perMetre; } else camera.perMetre *= event.key === "+" ? 1.2 : 1 / 1.2;
});

export function drawRoadside(tracks, cloud, ego) {
  const { pen, width, height, colour } = prepare("roadside");
  if (!tracks) { say("no data yet"); return; }
  const shown = tracks.message.tracks.filter((track) => track.state !== "tentative");
  fit(shown, width, height);
  remember(shown);
  const at = cloudIsOn() ? perspective(width, height) : plan(width, height);
  const palette = Object.fromEntries(CLASSES.map((name) => [name, colour(name)]));
  drawGrid(pen, colour, at, Math.max(width, height) / camera.perMetre);
  if (cloudIsOn() && cloud) drawCloud(pen, colour, at, cloud);
  pen.globalAlpha = tracks.ageMs > STALE_MS ? 0.3 : 1;
  for (const track of shown) drawTrack(pen, palette, at, track);
  nameTracks(pen, colour, at, shown);
  if (ego && ego.message.T_map_vehicle) drawVehicle(pen, colour, at, ego.message.T_map_vehicle);
  pen.globalAlpha = 1;
  const counts = {};
  for (const track of shown) counts[track.label] = (counts[track.label] ?? 0) + 1;
  const words = Object.entries(counts).map(([label, n]) => `${n} ${label.replace("_", " ")}`).join(", ") || "nobody";
  say(tracks.ageMs > STALE_MS ? `stale: ${ageWords(tracks.ageMs)} old` : tracks.message.reason ? `${words} · ${tracks.message.reason}` : words);
}

function say(text) {
  const words = document.getElementById("roadside-words");
  if (words.textContent !== text) words.textContent = text;
}

// Keep the traffic in view until the user takes over: half of the distance to the wanted view a draw.
function fit(tracks, width, height) {
  if (touched && camera.perMetre) return;
  const near = tracks.filter((t) => Math.max(...t.position_m.slice(0, 2).map(Math.abs)) < FIT_M);
  const xs = [-3, 20, ...near.map((t) => t.position_m[0])];
  const ys = [-20, 20, ...near.map((t) => t.position_m[1])];
  const [minX, maxX, minY, maxY] = [Math.min(...xs) - 4, Math.max(...xs) + 4, Math.min(...ys) - 4, Math.max(...ys) + 4];
  const wanted = Math.min(width / (maxY - minY), height / (maxX - minX));
  const ease = camera.perMetre ? 0.15 : 1;
  camera.perMetre += ease * (wanted - camera.perMetre);
  camera.x += ease * ((minX + maxX) / 2 - camera.x);
  camera.y += ease * ((minY + maxY) / 2 - camera.y);
}

const plan = (width, height) => (x, y) => [width / 2 - (y - camera.y) * camera.perMetre, height / 2 - (x - camera.x) * camera.perMetre];

function perspective(width, height) {
  const [c, s, ct, st] = [Math.cos(camera.turn), Math.sin(camera.turn), Math.cos(camera.tilt), Math.sin(camera.tilt)];
  return (x, y, z = 0) => {
    const [right, ahead] = [camera.y - y, x - camera.x];
    const [u, v] = [c * right + s * ahead, -s * right + c * ahead];
    return [width / 2 + u * camera.perMetre, height / 2 - (v * st + z * ct) * camera.perMetre];
  };
}

function drawGrid(pen, colour, at, span) {
  const reach = 10 * Math.ceil(span / 10);
  pen.strokeStyle = colour("line");
  const [x0, y0] = [Math.round(camera.x / 10) * 10, Math.round(camera.y / 10) * 10];
  for (let d = -reach; d <= reach; d += 10) {
    line(pen, at(x0 + d, y0 - reach), at(x0 + d, y0 + reach));
    line(pen, at(x0 - reach, y0 + d), at(x0 + reach, y0 + d));
  }
}

function drawCloud(pen, colour, at, cloud) {
  const points = list(cloud.message.points);
  const kinds = list(cloud.message.kind);
  const colours = [colour("soft"), colour("line"), colour("mark"), colour("soft")];
  pen.globalAlpha = cloud.ageMs > 1500 ? 0.2 : 0.8;
  for (let i = 0; i < points.length; i += 1) {
    const [x, y] = at(points[i][0], points[i][1], points[i][2]);
    pen.fillStyle = colours[kinds[i] ?? 0];
    pen.fillRect(x, y, 1.5, 1.5);
  }
  pen.globalAlpha = 1;
}

function remember(tracks) {
  const now = performance.now();
  for (const track of tracks) {
    const trail = trails.get(track.track_id) ?? [];
    const [x, y] = track.position_m;
    const last = trail[trail.length - 1];
    if (!last || Math.hypot(last.x - x, last.y - y) > 0.2) trail.push({ x, y, now });
    trails.set(track.track_id, trail);
  }
  for (const [id, trail] of trails) {
    while (trail.length && now - trail[0].now > TRAIL_MS) trail.shift();
    if (!trail.length) trails.delete(id);
  }
}

function drawTrack(pen, palette, at, track) {
  const [px, py, pz] = track.position_m;
  const [length, breadth] = track.size_m;
  const [c, s] = [Math.cos(track.yaw_rad), Math.sin(track.yaw_rad)];
  pen.strokeStyle = palette[track.label] ?? palette.unknown;
  pen.lineWidth = 2;
  pen.setLineDash(track.state === "coasting" ? [4, 3] : []);
  pen.beginPath();
  for (const [i, j] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
    const [dx, dy] = [(i * length) / 2, (j * breadth) / 2];
    pen.lineTo(...at(px + c * dx - s * dy, py + s * dx + c * dy, pz));
  }
  pen.closePath();
  pen.stroke();
  pen.setLineDash([]);
  pen.lineWidth = 1;
  const trail = trails.get(track.track_id) ?? [];
  pen.beginPath();
  for (const spot of trail) pen.lineTo(...at(spot.x, spot.y));
  pen.stroke();
  const [vx, vy] = track.velocity_mps;
  pen.lineWidth = 2;
  if (Math.hypot(vx, vy) > SLOW_MPS) arrow(pen, at(px, py, pz), at(px + vx, py + vy, pz));
  pen.lineWidth = 1;
}

// Where it will be in a second.
function arrow(pen, from, to) {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  line(pen, from, to);
  pen.beginPath();
  pen.moveTo(to[0] - 7 * Math.cos(angle - 0.5), to[1] - 7 * Math.sin(angle - 0.5));
  pen.lineTo(...to);
  pen.lineTo(to[0] - 7 * Math.cos(angle + 0.5), to[1] - 7 * Math.sin(angle + 0.5));
  pen.stroke();
}

// Class, id and speed beside each track, the nearest first; no two names over each other.
function nameTracks(pen, colour, at, tracks) {
  const taken = [];
  pen.fillStyle = colour("text");
  for (const track of [...tracks].sort((a, b) => Math.hypot(...a.position_m) - Math.hypot(...b.position_m))) {
    const speed = Math.hypot(...track.velocity_mps);
    if (speed <= SLOW_MPS && camera.perMetre <= 12) continue;
    const text = `${SHORT[track.label] ?? track.label} #${track.track_id % 10000}${speed > SLOW_MPS ? ` ${speed.toFixed(1)} m/s` : ""}`;
    const [x, y] = at(...track.position_m);
    const box = [x + 6, y - 17, x + 6 + pen.measureText(text).width, y - 3];
    if (taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3])) continue;
    taken.push(box);
    pen.fillText(text, x + 6, y - 6);
  }
}

function drawVehicle(pen, colour, at, T) {
  const [x, y] = at(T[0][3], T[1][3]);
  pen.fillStyle = colour("text");
  pen.fillRect(x - 4, y - 4, 8, 8);
  pen.fillText("vehicle", x + 7, y + 14);
}

function line(pen, from, to) {
  pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to); pen.stroke();
}
