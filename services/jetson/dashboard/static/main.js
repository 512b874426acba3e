// One socket, one state, one draw per period. Everything drawn carries its age; what is too old is drawn as stale.
import { connect, newest, silentMs, state } from "/static/store.js";
import { drawVerdict, drawOrigin, drawHealth, drawSlim, drawSensors, drawServices, drawHistory, drawLatency, drawRecording } from "/static/words.js";
import { drawTimeline } from "/static/timeline.js";
import { drawAhead } from "/static/ahead.js";
import { drawRadar } from "/static/radar.js";
import { cloudIsOn, drawRoadside, onCloudToggle } from "/static/roadside.js";
import { drawCamera } from "/static/camera.js";
import { drawGate } from "/static/gate.js";
import { soundFor } from "/static/sound.js";

const CUT_AFTER_MS = 1000;
const rate = document.getElementById("rate");
const views = [...document.querySelectorAll("[data-products]")];
const inSight = new Set();

// Only what is on the screen, or nearly: a phone asks for a view or two.
function wanted() {
  if (document.hidden) return ["fusion/verdict"];
  const products = new Set(["fusion/verdict", "fusion/health", "gate/state", ...[...inSight].flatMap((view) => view.dataset.products.split(" "))]);
  if (!cloudIsOn()) products.delete("infra_lidar/points");
  return [...products];
}

const tell = connect(() => ({ rate_hz: document.hidden ? 0.5 : Number(rate.value), products: wanted() }));
rate.addEventListener("change", tell);
document.addEventListener("visibilitychange", tell);
onCloudToggle(tell);
const observer = new IntersectionObserver((changes) => {
  for (const { target, isIntersecting } of changes) isIntersecting ? inSight.add(target) : inSight.delete(target);
  tell();
}, { rootMargin: "150px" });
for (const view of views) observer.observe(view);

function drawLink() {
  const silent = silentMs();
  const cut = silent > Math.max(CUT_AFTER_MS, 3000 / Number(rate.value));
  document.body.classList.toggle("cut", cut);
  const line = document.getElementById("link");
  line.hidden = !cut;
  if (cut) {
    const since = Number.isFinite(silent) ? `for ${(silent / 1000).toFixed(0)} s` : "yet";
    line.textContent = `No connection to the dashboard server ${since}. What you see is old.`;
  }
  return cut;
}

// The panel of a sensor that fusion does not know and that nobody runs would stay empty for ever.
function drawFitted(health, entries) {
  const runs = (sensor) => Object.keys(entries).some((key) => key.endsWith(`/${sensor}/status`));
  for (const panel of document.querySelectorAll("[data-sensor]")) {
    const { sensor } = panel.dataset;
    panel.hidden = health !== null && !(sensor in health.message.sensors) && !runs(sensor);
  }
}

function draw() {
  const cut = drawLink();
  const verdict = newest("fusion/verdict");
  const health = newest("fusion/health");
  const zones = newest("lidar/zones");
  const radar = newest("radar/tracks");
  const face = drawVerdict(verdict, cut);
  soundFor(face === "BLIND" ? verdict.message.level : face);
  drawOrigin(health, verdict);
  drawHealth(health, cut);
  drawGate(newest("gate/state"), cut);
  drawSlim(face);
  drawFitted(health, state.entries);
  drawSensors(health, verdict);
  drawLatency(health, verdict, newest("fusion/status"));
  drawServices(state.entries);
  drawRecording(state.entries, cut);
  drawHistory(state.verdicts, state.healths);
  drawTimeline(state.verdicts, face);
  drawAhead(newest("lidar/scan"), zones, radar, newest("fusion/verdict"));
  drawRadar(radar);
  drawRoadside(newest("infra_lidar/tracks"), newest("infra_lidar/points"), newest("ego/motion"));
  drawCamera(newest("camera/image"), newest("camera/detections"));
}

setInterval(() => { if (!document.hidden) requestAnimationFrame(draw); }, 100);
requestAnimationFrame(draw);
