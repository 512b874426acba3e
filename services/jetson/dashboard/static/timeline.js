// The verdicts of the last minute, later of the last five, as one strip: colour and height, so that it reads without
// colour too.
import { prepare } from "/static/canvas.js";
import { utcMs } from "/static/store.js";

const SHORT = { span: 60_000, step: 15_000, name: (ms) => `${ms / 1000} s ago` };
const LONG = { span: 300_000, step: 60_000, name: (ms) => `${ms / 60_000} min ago` };
const HEIGHT = { SAFE: 0.3, CAUTION: 0.65, IMMINENT: 1.0 };

export function drawTimeline(verdicts, face) {
  const { pen, width, height, colour } = prepare("timeline");
  if (!verdicts.length) return;
  const now = utcMs();
  const scale = now - verdicts[0].stamp_ns / 1e6 < SHORT.span ? SHORT : LONG;
  const x = (ms) => width * (1 - (now - ms) / scale.span);
  verdicts.forEach((verdict, index) => {
    const next = verdicts[index + 1];
    const from = Math.max(0, x(verdict.stamp_ns / 1e6));
    const to = next ? x(next.stamp_ns / 1e6) : face === "none" ? from : width;
    if (to <= 0) return;
    const tall = HEIGHT[verdict.level] * (height - 20);
    pen.fillStyle = colour(verdict.level.toLowerCase());
    pen.fillRect(from, height - tall, Math.max(1, to - from), tall);
  });
  pen.fillStyle = colour("soft");
  for (let ago = scale.step; ago < scale.span; ago += scale.step) pen.fillText(scale.name(ago), x(now - ago) + 3, 14);
}
