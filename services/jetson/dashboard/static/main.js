// One websocket, one state, one draw per frame. Everything drawn carries its age; what is too old is drawn as stale.
import { drawVerdict, drawHealth, drawSensors, drawServices, drawHistory } from "/static/words.js";
import { drawAhead } from "/static/ahead.js";
import { drawRoadside } from "/static/roadside.js";

const RATE_HZ = 10;
const PRODUCTS = ["radar/tracks", "lidar/scan", "lidar/zones", "camera/detections", "camera/image", "infra_lidar/tracks",
  "fusion/verdict", "fusion/health", "ego/motion"];
const CUT_AFTER_MS = 1000;

const state = { entries: {}, verdicts: [], healths: [], arrivedMs: -Infinity };
let retryMs = 250;
let shownImage = "";

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/ws${location.search}`);
  socket.onopen = () => {
    retryMs = 250;
    socket.send(JSON.stringify({ rate_hz: RATE_HZ, products: PRODUCTS }));
  };
  socket.onmessage = (event) => {
    Object.assign(state, JSON.parse(event.data));
    state.arrivedMs = performance.now();
  };
  socket.onclose = () => {
    setTimeout(connect, retryMs);
    retryMs = Math.min(2 * retryMs, 2000);
  };
}

// The newest message of a product on any host, its age now, and the host.
export function newest(product) {
  const extraMs = performance.now() - state.arrivedMs;
  let best = null;
  for (const [key, entry] of Object.entries(state.entries)) {
    if (key.split("/").slice(1).join("/") !== product) continue;
    const ageMs = entry.age_ms + extraMs;
    if (!best || ageMs < best.ageMs) best = { host: key.split("/")[0], ageMs, message: entry.message };
  }
  return best;
}

function drawLink() {
  const silentMs = performance.now() - state.arrivedMs;
  const cut = silentMs > CUT_AFTER_MS;
  document.body.classList.toggle("cut", cut);
  const line = document.getElementById("link");
  line.hidden = !cut;
  if (cut) {
    const since = Number.isFinite(silentMs) ? `for ${(silentMs / 1000).toFixed(0)} s` : "yet";
    line.textContent = `No connection to the dashboard server ${since}. What you see is old.`;
  }
  return cut;
}

function drawCamera() {
  const image = newest("camera/image");
  const picture = document.getElementById("camera");
  const words = document.getElementById("camera-words");
  const detections = newest("camera/detections");
  if (image) {
    const wanted = `${image.host}:${image.message.stamp_ns}`;
    if (wanted !== shownImage && (picture.complete || !shownImage)) {
      shownImage = wanted;
      picture.src = `/api/image/${image.host}?stamp=${image.message.stamp_ns}`;
      picture.hidden = false;
    }
    picture.classList.toggle("stale", image.ageMs > 1000);
  }
  if (detections) {
    const seen = detections.message.detections.map((d) => `${d.label} ${d.truncated ? "at most " : ""}${d.distance_m.toFixed(1)} m`);
    words.textContent = detections.ageMs > 1000 ? `stale for ${(detections.ageMs / 1000).toFixed(1)} s` : seen.join(", ") || "nothing recognised";
  }
}

function draw() {
  const cut = drawLink();
  drawVerdict(newest("fusion/verdict"), cut);
  drawHealth(newest("fusion/health"), cut);
  drawSensors(newest("fusion/health"), newest("fusion/verdict"), newest("infra_lidar/tracks"));
  drawServices(state.entries, performance.now() - state.arrivedMs);
  drawHistory(state.verdicts, state.healths);
  drawAhead(newest("lidar/scan"), newest("lidar/zones"), newest("radar/tracks"));
  drawRoadside(newest("infra_lidar/tracks"), newest("ego/motion"));
  drawCamera();
}

connect();
setInterval(() => { if (!document.hidden) requestAnimationFrame(draw); }, 1000 / RATE_HZ);
requestAnimationFrame(draw);
