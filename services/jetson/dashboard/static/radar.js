// Range against velocity (closing is left), and a bar per approaching track: the shorter, the sooner.
import { prepare, LEVEL_COLOURS } from "/static/canvas.js";
import { ageWords } from "/static/store.js";

const STALE_MS = 500;
const TTC_SPAN_S = 4;
const [LEFT, RIGHT, BELOW] = [34, 14, 36]; // room for the axes' words
const ALARM_M = [[0.5, "imminent-text"], [1.2, "caution-text"]];

export function drawRadar(radar) {
  const { pen, width, height, colour } = prepare("radar");
  const speed = radar ? Math.max(2, Math.min(6, radar.message.v_max_mps || 3)) : 3;
  const reach = radar ? radar.message.range_max_m || 6 : 6;
  const middle = LEFT + (width - LEFT - RIGHT) / 2;
  const at = (v, r) => [middle + (v / speed) * (middle - LEFT), height - BELOW - (r / reach) * (height - BELOW - 14)];
  drawAxes(pen, colour, at, speed, reach, height);
  for (const [range, name] of ALARM_M) {
    pen.strokeStyle = colour(name);
    pen.setLineDash([6, 4]);
    line(pen, at(-speed, range), at(0, range));
    pen.setLineDash([]);
  }
  if (!radar) return;
  pen.globalAlpha = radar.ageMs > STALE_MS ? 0.25 : 1;
  for (const track of radar.message.tracks) {
    const [x, y] = at(track.velocity_mps, track.range_m);
    pen.fillStyle = colour(LEVEL_COLOURS[track.level]);
    pen.beginPath(); pen.arc(x, y, 6, 0, 2 * Math.PI); pen.fill();
    pen.textAlign = track.velocity_mps > speed / 2 ? "right" : "left"; // its words stay inside
    pen.fillText(`#${track.track_id} ${track.range_m.toFixed(1)} m`, x + (pen.textAlign === "left" ? 9 : -9), y + 4);
  }
  pen.globalAlpha = 1;
  pen.textAlign = "left";
  drawBars(radar);
  describe(radar);
}

function drawAxes(pen, colour, at, speed, reach, height) {
  pen.strokeStyle = colour("line");
  pen.fillStyle = colour("soft");
  pen.textAlign = "center";
  for (let v = -Math.floor(speed); v <= speed; v += 1) {
    line(pen, at(v, 0), at(v, reach));
    pen.fillText(`${v}`, at(v, 0)[0], height - BELOW + 14);
  }
  pen.fillText("← closing · m/s · leaving →", at(0, 0)[0], height - 5);
  pen.textAlign = "right";
  for (let range = 0; range <= reach; range += reach > 12 ? 5 : reach > 4 ? 2 : 1) {
    line(pen, at(-speed, range), at(speed, range));
    pen.fillText(`${range} m`, LEFT - 5, at(0, range)[1] + 4);
  }
  pen.textAlign = "left";
}

function line(pen, from, to) {
  pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to); pen.stroke();
}

function drawBars(radar) {
  const old = radar.ageMs > STALE_MS;
  const panel = document.getElementById("ttc");
  panel.classList.toggle("stale", old);
  const bars = radar.message.tracks.filter((track) => track.ttc_s !== null).sort((a, b) => a.ttc_s - b.ttc_s).slice(0, 4);
  panel.replaceChildren(...bars.map((track) => {
    const bar = document.createElement("div");
    const fill = document.createElement("i");
    const words = document.createElement("span");
    fill.style.width = `${Math.max(2, 100 * Math.min(1, track.ttc_s / TTC_SPAN_S))}%`;
    fill.style.background = `var(--${track.level.toLowerCase()})`;
    words.textContent = `${old ? "old: " : ""}#${track.track_id} ${track.level}: ${track.ttc_s.toFixed(1)} s to collision, ${(-track.velocity_mps).toFixed(1)} m/s closing`;
    bar.append(fill, words);
    return bar;
  }));
}

function describe(radar) {
  const message = radar.message;
  const view = !message.settled ? "settling: a clear radar means nothing yet" : message.reason || `noise floor ${message.noise_floor_db.toFixed(0)} dB, sees ${message.range_min_m.toFixed(1)} to ${message.range_max_m.toFixed(1)} m, up to ${message.v_max_mps.toFixed(1)} m/s`;
  const text = radar.ageMs > STALE_MS ? `stale: ${ageWords(radar.ageMs)} old` : view;
  const words = document.getElementById("radar-words");
  if (words.textContent !== text) words.textContent = text;
}
