// An optional tone while the verdict is IMMINENT; browsers allow it only after the button was pressed.
const button = document.getElementById("sound");
let audio = null;
let lastBeepMs = 0;

button.addEventListener("click", () => {
  const on = button.getAttribute("aria-pressed") !== "true";
  button.setAttribute("aria-pressed", String(on));
  button.textContent = `Sound on IMMINENT: ${on ? "on" : "off"}`;
  if (on && !audio) audio = new AudioContext();
});

export function soundFor(level) {
  const now = performance.now();
  if (level !== "IMMINENT" || !audio || button.getAttribute("aria-pressed") !== "true" || now - lastBeepMs < 500) return;
  lastBeepMs = now;
  const tone = audio.createOscillator();
  const volume = audio.createGain();
  tone.frequency.value = 880;
  volume.gain.setValueAtTime(0.2, audio.currentTime);
  volume.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + 0.25);
  tone.connect(volume).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.25);
}
