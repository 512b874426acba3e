// Verdict, health bar, tables and history: everything that is text.
const NO_VERDICT_AFTER_MS = 300;
const NO_HEALTH_AFTER_MS = 2500;
const SIGNS = { SAFE: "✓", CAUTION: "!", IMMINENT: "✕" };
const byId = (id) => document.getElementById(id);

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function drawVerdict(verdict, cut) {
  const box = byId("verdict");
  const fresh = verdict && !cut && verdict.ageMs < NO_VERDICT_AFTER_MS;
  const level = fresh ? verdict.message.level : "none";
  box.className = `verdict ${level}`;
  setText(box.querySelector(".sign"), fresh ? SIGNS[level] : "?");
  setText(byId("level"), fresh ? level : "NO VERDICT");
  const flags = fresh ? ["suppressed", "blind"].filter((name) => verdict.message[name]) : [];
  if (fresh && verdict.message.advisory) flags.push(verdict.message.advisory);
  const marks = flags.length ? ` [${flags.join(", ")}]` : "";
  const lost = verdict ? `the last verdict is ${(verdict.ageMs / 1000).toFixed(1)} s old; treat as STOP` : "waiting for the first verdict";
  setText(byId("because"), fresh ? verdict.message.because + marks : lost);
  setText(byId("permission"), fresh ? verdict.message.permission : "STOP");
  setText(byId("verdict-age"), fresh ? `rule ${verdict.message.rule}` : "");
}

export function drawHealth(health, cut) {
  const fresh = health && !cut && health.ageMs < NO_HEALTH_AFTER_MS;
  byId("health").className = `health ${fresh ? health.message.colour : "none"}`;
  setText(byId("health"), fresh ? health.message.summary : "HEALTH UNKNOWN: fusion does not publish");
}

function fill(body, rows) {
  const wanted = rows.map((cells) => cells.map((cell) => `${cell.className ?? ""}|${cell.text}`).join("¦")).join("\n");
  if (body.dataset.shown === wanted) return;
  body.dataset.shown = wanted;
  body.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    row.append(...cells.map((cell, index) => {
      const element = document.createElement(index ? "td" : "th");
      if (!index) element.scope = "row";
      element.textContent = cell.text;
      element.className = cell.className ?? "";
      return element;
    }));
    return row;
  }));
}

const age = (ms) => (ms === null || ms === undefined ? "never" : ms < 950 ? `${Math.round(ms / 50) * 50} ms` : `${(ms / 1000).toFixed(1)} s`);

export function drawSensors(health, verdict) {
  if (!health) return;
  const inputs = verdict ? verdict.message.inputs : {};
  const rows = Object.entries(health.message.sensors).map(([name, sensor]) => {
    const input = inputs[name];
    const level = input && input.level;
    return [
      { text: name },
      { text: sensor.state, className: sensor.state },
      { text: level ?? "nothing", className: level ? `${level}-text` : "" },
      { text: age(sensor.age_ms === null ? null : sensor.age_ms + health.ageMs) },
      { text: `${sensor.rate_hz.toFixed(0)} Hz` },
      { text: sensor.reason || (input ? input.why : "") },
    ];
  });
  fill(byId("sensors"), rows);
}

export function drawServices(entries, extraMs) {
  const rows = Object.entries(entries).filter(([key]) => key.endsWith("/status")).sort().map(([key, entry]) => {
    const status = entry.message;
    const gone = entry.age_ms + extraMs > 3000;
    const state = gone ? "disconnected" : status.state;
    return [
      { text: key.replace("/status", "") },
      { text: gone ? `silent for ${age(entry.age_ms + extraMs)}` : status.reason ? `${status.state}: ${status.reason}` : status.state, className: state },
      { text: `${status.rate_hz.toFixed(0)} Hz` },
      { text: `${status.rss_mb.toFixed(0)} MB` },
      { text: `${status.bad_input}` },
    ];
  });
  fill(byId("services"), rows);
}

export function drawHistory(verdicts, healths) {
  const rows = [
    ...verdicts.map((v) => ({ stamp: v.stamp_ns, text: `${v.level} (${v.rule}): ${v.because}`, className: `${v.level}-text` })),
    ...healths.map((h) => ({ stamp: h.stamp_ns, text: `${h.sensor} ${h.state}${h.reason ? ": " + h.reason : ""}`, className: h.state })),
  ].sort((a, b) => b.stamp - a.stamp).slice(0, 60);
  const list = byId("history");
  const wanted = rows.length ? `${rows[0].stamp}:${rows.length}` : "";
  if (list.dataset.shown === wanted) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...rows.map((row) => {
    const item = document.createElement("li");
    const time = document.createElement("time");
    time.textContent = new Date(row.stamp / 1e6).toLocaleTimeString();
    const words = document.createElement("span");
    words.className = row.className;
    words.textContent = row.text;
    item.append(time, words);
    return item;
  }));
}
