// The newest picture, fetched by its own stamp, one at a time: a slow link shows fewer, never a queue. The words below it
// are of the message that was drawn into it, so that both say the same.
import { ageWords } from "/static/store.js";

const PICTURE_STALE_MS = 1500;
const WORDS_STALE_MS = 1000;
let shown = "";
let seenInPicture = null;
let asked = null;
const picture = document.getElementById("camera");
const words = document.getElementById("camera-words");
picture.addEventListener("load", () => { seenInPicture = asked; });

export function drawCamera(image, detections) {
  if (image) {
    const wanted = `${image.host}:${image.message.stamp_ns}`;
    if (wanted !== shown && (picture.complete || !shown)) {
      shown = wanted;
      asked = image.message.seen;
      picture.src = `/api/image/${image.host}?stamp=${image.message.stamp_ns}`;
      picture.hidden = false;
    }
    picture.classList.toggle("stale", image.ageMs > PICTURE_STALE_MS);
  }
  if (!detections) return;
  const fresh = image && seenInPicture && image.ageMs <= PICTURE_STALE_MS;
  const text = detections.ageMs > WORDS_STALE_MS ? `stale: ${ageWords(detections.ageMs)} old` : describe(fresh ? seenInPicture : detections.message);
  if (words.textContent !== text) words.textContent = text;
}

// As the label in the picture has it: to the object's nearest side, "<=" where the box is cut off.
function describe(message) {
  if (message.state === "degraded") return `cannot see: ${message.reason}`;
  const each = message.detections.map((d) => `${d.label} ${d.truncated ? "<= " : ""}${(d.nearest_m ?? d.distance_m).toFixed(1)} m${d.in_zone ? "" : " (beside)"}`);
  return each.join(", ") || "nothing recognised";
}
