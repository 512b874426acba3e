// Verdict, health bar, tables and history: everything that is text.
import { ageMs, ageWords } from "/static/store.js";

const NO_VERDICT_AFTER_MS = 300;
const NO_HEALTH_AFTER_MS = 2500;
const SIGNS = { SAFE: "✓", CAUTION: "!", IMMINENT: "✕", BLIND: "⊘" };
const SPOKEN = { lidar: "LiDAR", infra_lidar: "roadside LiDAR" };
export const spoken = (sensor) => SPOKEN[sensor] ?? sensor.replaceAll("_", " ");
const byId = (id) => document.getElementById(id);

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Draws the banner and returns its face: the level, "BLIND" for a vehicle that sees nothing whatever others tell it, or
// "none" when there is no verdict to trust.
export function drawVerdict(verdict, cut) {
  const fresh = verdict && !cut && verdict.ageMs < NO_VERDICT_AFTER_MS + 1000 / Number(byId("rate").value);
  const face = !fresh ? "none" : verdict.message.blind ? "BLIND" : verdict.message.level;
  const wanted = `verdict ${face}`;
  if (byId("verdict").className !== wanted) byId("verdict").className = wanted;
  setText(document.querySelector(".sign span"), fresh ? SIGNS[face] : "?");
  setText(byId("level"), fresh ? face : "NO VERDICT");
  const flags = fresh && verdict.message.suppressed ? ["suppressed"] : [];
  if (fresh && verdict.message.advisory) flags.push(verdict.message.advisory.toLowerCase().replace("_", " "));
  const marks = flags.length ? ` [${flags.join(", ")}]` : "";
  const lost = verdict ? `the last verdict is ${(verdict.ageMs / 1000).toFixed(0)} s old; treat as STOP` : "waiting for the first verdict";
  setText(byId("because"), fresh ? verdict.message.because + marks : lost);
  setText(byId("permission"), fresh ? verdict.message.permission : "STOP");
  setText(byId("rule"), fresh ? `${face === "BLIND" ? `${verdict.message.level}, ` : ""}rule ${verdict.message.rule}` : "");
  setText(byId("to-lower"), fresh && verdict.message.to_lower ? `To come down: ${verdict.message.to_lower}` : "");
  return face;
}

const ORIGINS = { recorded: "RECORDED DATA", emulated: "EMULATED DEVICE", simulated: "SIMULATED DATA", unknown: "DATA OF UNKNOWN ORIGIN" };

// A band across the page while anything that the verdict rests on is not live.
export function drawOrigin(health, verdict) {
  const heard = Object.entries(health ? health.message.sensors : {}).filter(([, sensor]) => sensor.age_ms !== null);
  const made = heard.filter(([, sensor]) => sensor.source_kind !== "live").map(([name, sensor]) => `${spoken(name)} ${sensor.source_kind}`);
  const kinds = Object.keys(ORIGINS).filter((kind) => heard.some(([, sensor]) => sensor.source_kind === kind) || ((heard.length || !health) && verdict && verdict.message.source_kind === kind));
  const kind = kinds.at(-1);
  if (byId("origin").hidden === Boolean(kind)) byId("origin").hidden = !kind;
  if (kind) setText(byId("origin"), `NOT LIVE, ${ORIGINS[kind]}: ${made.join(", ") || (health ? "the motion of the vehicle" : "what the verdict rests on")}`);
}

export function drawHealth(health, cut) {
  const fresh = health && !cut && health.ageMs < NO_HEALTH_AFTER_MS;
  byId("health").className = `health ${fresh ? health.message.colour : "none"}`;
  const unknown = cut ? "HEALTH UNKNOWN: no connection to the dashboard server" : "HEALTH UNKNOWN: fusion does not publish";
  const whose = health && health.message.vehicle ? `${health.message.vehicle}: ` : "";
  setText(byId("health"), whose + (fresh ? health.message.summary : unknown));
}

// One line that stays when the banner is scrolled away: the same words, so that both never differ.
export function drawSlim(face) {
  const slim = byId("slim");
  const away = byId("health").getBoundingClientRect().bottom < 0;
  if (slim.hidden === away) slim.hidden = !away;
  if (!away) return;
  const wanted = `slim ${face}`;
  if (slim.className !== wanted) slim.className = wanted;
  const words = [`${byId("level").textContent} → ${byId("permission").textContent}`, ...(byId("origin").hidden ? [] : ["NOT LIVE"]), byId("health").textContent];
  if (slim.dataset.shown === words.join()) return;
  slim.dataset.shown = words.join();
  slim.replaceChildren(...words.map((text, index) => {
    const element = document.createElement("span");
    element.textContent = text;
    element.className = index ? "rest" : "";
    return element;
  }));
}

function fill(body, rows) {
  const wanted = JSON.stringify(rows);
  if (body.dataset.shown === wanted) return;
  body.dataset.shown = wanted;
  body.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    row.append(...cells.map(([text, className], index) => {
      const element = document.createElement(index ? "td" : "th");
      if (!index) element.scope = "row";
      element.textContent = text;
      element.className = className ?? "";
      return element;
    }));
    return row;
  }));
}

// Fusion's reason to use or not to use a sensor often holds the sensor's own: then that is said once.
const plain = (text) => text.replace(/[0-9.]/g, "");
const whyOf = (reason, why) => (plain(why).includes(plain(reason)) ? why : [reason, why].filter(Boolean).join(" · "));

export const age = (ms) => (ms === null || ms === undefined ? "never" : ageWords(ms));
const clock = (ns) => new Date(ns / 1e6).toLocaleTimeString([], { hourCycle: "h23" });

// What fusion said when it was last heard is no longer known to hold.
const isOld = (health) => Boolean(health) && health.ageMs >= NO_HEALTH_AFTER_MS;

export function drawSensors(health, verdict) {
  if (!health) return;
  const old = isOld(health);
  byId("sensors").classList.toggle("stale", old);
  const inputs = verdict ? verdict.message.inputs : {};
  fill(byId("sensors"), Object.entries(health.message.sensors).map(([name, sensor]) => {
    const input = inputs[name];
    const level = input && input.level;
    const aged = input && input.age_ms !== null ? input.age_ms + verdict.ageMs : sensor.age_ms === null ? null : sensor.age_ms + health.ageMs;
    return [
      [spoken(name)],
      old ? [`unknown, was ${sensor.state}`] : [sensor.state === "online" ? "online" : `${sensor.state} since ${sensor.since_ns ? clock(sensor.since_ns) : "the start"}`, sensor.state],
      [sensor.source_kind, sensor.source_kind === "live" ? "" : "made-up"],
      [level ?? "nothing", level && !old ? `${level}-text` : ""],
      [age(aged), "num"],
      [`${sensor.rate_hz.toFixed(0)} Hz`, "num"],
      [whyOf(sensor.reason, input ? input.why : "")],
    ];
  }));
}

// Fusion's percentiles are in the table of latencies.
const stages = (split) => Object.entries(split ?? {}).filter(([name]) => !/_p\d+$/.test(name)).map(([name, ms]) => `${name} ${ms.toFixed(1)}`).join(" · ");

// A recorder's last word: it was stopped, nothing is lost. Only a recorder ends while the system runs.
const hasEnded = (entry) => entry.message.reason.startsWith("ended: ");

export function drawServices(entries) {
  fill(byId("services"), Object.entries(entries).filter(([key, entry]) => key.endsWith("/status") && !hasEnded(entry)).sort().map(([key, entry]) => {
    const status = entry.message;
    const silent = ageMs(entry);
    const gone = silent > 3500;
    const words = gone ? `silent for ${age(silent)}` : status.reason ? `${status.state}: ${status.reason}` : status.state;
    return [
      [key.replace("/status", "")],
      [words, gone ? "disconnected" : status.state],
      [status.rate_hz ? `${status.rate_hz.toFixed(0)} Hz` : "", "num"],
      [`${status.rss_mb.toFixed(0)} MB`, "num"],
      [`${status.bad_input}`, "num"],
      [stages(status.stage_ms) && `${stages(status.stage_ms)} ms`],
    ];
  }));
}

// What is kept of what happens: recorders and blackboxes, by their own status.
export function drawRecording(entries, cut) {
  if (cut) return setText(byId("recording"), "Nobody knows here what is recorded");
  const running = (service) => Object.entries(entries)
    .filter(([key, entry]) => key.endsWith(`/${service}/status`) && ageMs(entry) < 3500 && !hasEnded(entry))
    .map(([key, { message }]) => [key.split("/")[0], message]);
  const recorders = running("recorder").map(([host, { reason }]) => `● Recording on ${host}: ${reason}`);
  const boxes = running("blackbox").map(([host, { counters }]) => {
    const kept = counters.incidents ?? 0;
    return `${host} (${kept} incident${kept === 1 ? "" : "s"} since its start)`;
  });
  const kept = boxes.length ? `Blackbox on ${boxes.join(", ")}` : "No blackbox runs";
  setText(byId("recording"), recorders.length || boxes.length ? [...recorders, kept].join(" · ") : "Nothing is recorded: no recorder and no blackbox runs");
}

// Where the time goes from the measurement to the first verdict that counts it; percentiles over the last 256 inputs.
export function drawLatency(health, verdict, fusion) {
  const ms = (value) => [value === undefined ? "" : value.toFixed(value < 99.95 ? 1 : 0), "num"];
  const whole = fusion ? fusion.message.stage_ms : {};
  const inputs = Object.entries(verdict ? verdict.message.inputs : {}).filter(([, input]) => Object.keys(input.stage_ms ?? {}).length);
  const rows = inputs.map(([name, { stage_ms: split }]) => [[spoken(name)], ms(split.capture), ms(split.processing), ms(split.transport), ms(whole[`${name}_p50`]), ms(whole[`${name}_p99`])]);
  if ("fusion_p50" in whole) rows.push([["fusion"], [""], [""], [""], ms(whole.fusion_p50), ms(whole.fusion_p99)]);
  fill(byId("latency"), rows);
  const old = isOld(health);
  byId("clocks").classList.toggle("stale", old);
  fill(byId("clocks"), Object.entries(health ? health.message.clocks : {}).map(([host, clock]) => [
    [host], [`${clock.offset_ms >= 0 ? "+" : ""}${clock.offset_ms.toFixed(2)} ms`, "num"], [`${clock.bound_ms.toFixed(2)} ms`, "num"],
    old ? ["unknown"] : [clock.trusted ? "trusted" : "not trusted", clock.trusted ? "online" : "disconnected"],
  ]));
  setText(byId("notes"), health ? health.message.notes.join(" · ") : "");
}

export function drawHistory(verdicts, healths) {
  const rows = [
    ...verdicts.map((v) => ({ stamp: v.stamp_ns, text: `${v.level} (${v.rule}): ${v.because}`, className: `${v.level}-text` })),
    ...healths.map((h) => ({ stamp: h.stamp_ns, text: `${spoken(h.sensor)} ${h.state}${h.reason ? ": " + h.reason : ""}`, className: h.state })),
  ].sort((a, b) => b.stamp - a.stamp).slice(0, 80);
  const list = byId("history");
  const wanted = rows.length ? `${rows[0].stamp}:${rows.length}` : "";
  if (list.dataset.shown === wanted) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...rows.map((row) => {
    const item = document.createElement("li");
    const time = document.createElement("time");
    time.textContent = clock(row.stamp);
    const words = document.createElement("span");
    words.className = row.className;
    words.textContent = row.text;
    item.append(time, words);
    return item;
  }));
}
