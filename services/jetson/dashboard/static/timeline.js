// The verdicts of the last five minutes as one strip: colour and height, so that it reads without colour too.
import { prepare } from "/static/canvas.js";

const WINDOW_MS = 300_000;
const HEIGHT = { SAFE: 0.3, CAUTION: 0.65, IMMINENT: 1.0 };

export function drawTimeline(verdicts, level) {
  const { pen, width, height, colour } = prepare("timeline");
  if (!verdicts.length) return;
  const now = Date.now();
  const x = (ms) => width * (1 - (now - ms) / WINDOW_MS);
  verdicts.forEach((verdict, index) => {
    const next = verdicts[index + 1];
    const from = Math.max(0, x(verdict.stamp_ns / 1e6));
    const to = next ? x(next.stamp_ns / 1e6) : level === "none" ? from : width;
    if (to <= 0) return;
    const tall = HEIGHT[verdict.level] * (height - 14);
    pen.fillStyle = colour(verdict.level.toLowerCase());
    pen.fillRect(from, height - tall, Math.max(1, to - from), tall);
  });
  pen.fillStyle = colour("soft");
  for (let minute = 1; minute < 5; minute += 1) pen.fillText(`${minute} min ago`, x(now - minute * 60_000) + 3, 11);
}
