// The newest picture, fetched one at a time: a slow link shows fewer, never a queue. The words below it are those that are
// written in it, and change with it.
import { ageWords } from "/static/store.js";

const PICTURE_STALE_MS = 1500;
const WORDS_STALE_MS = 1000;
const GIVE_UP_MS = 5000; // a server that vanished answers never, and the next picture would wait for this one
let picture = document.getElementById("camera");
const words = document.getElementById("camera-words");
let asked = "";
let busy = false;
let inPicture = null;

export function drawCamera(image, detections) {
  if (image && image.message.address !== asked && !busy) show(image.message);
  if (image) picture.classList.toggle("stale", image.ageMs > PICTURE_STALE_MS);
  if (!detections) return;
  const pictured = image && inPicture !== null && image.ageMs <= PICTURE_STALE_MS;
  say(detections.ageMs > WORDS_STALE_MS ? `stale: ${ageWords(detections.ageMs)} old` : pictured ? inPicture : describe(detections.message, detections.message.detections.map(caption)));
}

async function show(message) {
  asked = message.address;
  busy = true;
  try {
    const reply = await fetch(message.address, { signal: AbortSignal.timeout(GIVE_UP_MS) });
    if (!reply.ok) return; // it is no longer kept: the next one
    const blob = await reply.blob();
    const next = picture.cloneNode(); // with the address of the picture before: replaced before anything loads it again
    next.src = URL.createObjectURL(blob);
    await next.decode();
    next.hidden = false;
    picture.replaceWith(next);
    URL.revokeObjectURL(picture.src);
    picture = next;
    inPicture = describe(message, message.captions);
    say(inPicture);
  } catch { // the server is away, which the page says elsewhere; or no picture came in time
  } finally {
    busy = false;
  }
}

function say(text) {
  if (words.textContent !== text) words.textContent = text;
}

// As a picture has it: to the object's nearest side, "<=" where the box is cut off.
const caption = (d) => `${d.label} ${d.truncated ? "<= " : ""}${(d.nearest_m ?? d.distance_m).toFixed(1)} m${d.in_zone ? "" : " (beside)"}`;

function describe(message, captions) {
  if (message.state === "degraded") return `cannot see: ${message.reason}`;
  return captions.join(", ") || "nothing recognised";
}
