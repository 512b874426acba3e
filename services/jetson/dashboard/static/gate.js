// What the gate tells the actuator, in one line under the sensors; nothing where there is no gate.
const SILENT_AFTER_MS = 500;

export function gateWords(gate, cut) {
  if (!gate) return "";
  if (cut || gate.ageMs > SILENT_AFTER_MS) return `Gate: silent for ${(gate.ageMs / 1000).toFixed(0)} s, the actuator stops by itself`;
  const { permission, limit_mps: limit, because, acknowledge, state, reason } = gate.message;
  const most = permission === "STOP" ? "" : `, at most ${limit} m/s`;
  const person = acknowledge ? "; a person has to acknowledge" : "";
  return `Gate: ${permission}${most}: ${because}${person}${state === "online" ? "" : ` (${reason})`}`;
}

export function drawGate(gate, cut) {
  const line = document.getElementById("gate");
  const words = gateWords(gate, cut);
  if (line.hidden === Boolean(words)) line.hidden = !words;
  if (line.textContent !== words) line.textContent = words;
}
