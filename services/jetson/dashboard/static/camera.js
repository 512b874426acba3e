// The newest picture, fetched by its own stamp, one at a time: a slow link shows fewer, never a queue.
let shown = "";
const picture = document.getElementById("camera");
const words = document.getElementById("camera-words");

export function drawCamera(image, detections) {
  if (image) {
    const wanted = `${image.host}:${image.message.stamp_ns}`;
    if (wanted !== shown && (picture.complete || !shown)) {
      shown = wanted;
      picture.src = `/api/image/${image.host}?stamp=${image.message.stamp_ns}`;
      picture.hidden = false;
    }
    picture.classList.toggle("stale", image.ageMs > 1500);
  }
  if (!detections) return;
  const seen = detections.message.detections.map((d) => `${d.label} ${d.truncated ? "at most " : ""}${d.distance_m.toFixed(1)} m${d.in_zone ? "" : " (beside)"}`);
  const view = detections.message.state === "degraded" ? `cannot see: ${detections.message.reason}` : seen.join(", ") || "nothing recognised";
  const text = detections.ageMs > 1000 ? `stale for ${(detections.ageMs / 1000).toFixed(1)} s` : view;
  if (words.textContent !== text) words.textContent = text;
}
