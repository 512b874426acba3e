// The newest of everything, as the server last told it, and how old each thing is by now. What is not asked for at the
// moment stays, but it is not shown: its age here says nothing of the sensor.
export const state = { entries: {}, verdicts: [], healths: [], stampMs: 0, arrivedMs: -Infinity };

export const silentMs = () => performance.now() - state.arrivedMs;
// UTC as the server's host has it: this machine's clock may be wrong.
export const utcMs = () => state.stampMs + silentMs();
export const ageMs = (entry) => performance.now() - entry.sinceMs;
export const ageWords = (ms) => (ms < 950 ? `${Math.round(ms / 50) * 50} ms` : `${(ms / 1000).toFixed(1)} s`);

function take({ stamp_ns: stampNs, entries, verdicts, healths }) {
  const now = performance.now();
  for (const [key, { age_ms: age, message }] of Object.entries(entries)) state.entries[key] = { message, sinceMs: now - age, toldMs: now };
  Object.assign(state, { verdicts, healths, stampMs: stampNs / 1e6, arrivedMs: now });
}

// The newest message of a product on any host, its age now, and the host; null when the server told of none the last
// time, because there never was one or because it was not asked for.
export function newest(product) {
  let best = null;
  for (const [key, entry] of Object.entries(state.entries)) {
    if (key.slice(key.indexOf("/") + 1) !== product || entry.toldMs !== state.arrivedMs) continue;
    if (!best || ageMs(entry) < best.ageMs) best = { host: key.split("/")[0], ageMs: ageMs(entry), message: entry.message };
  }
  return best;
}

// Longer than a large snapshot takes over a slow link. A server without power ends no connection, and we would wait on.
const GIVE_UP_MS = 10_000;

// One websocket that comes back by itself; it tells the server what this page looks at and how often.
export function connect(wish) {
  let retryMs = 250;
  let socket = null;
  let heardMs = 0;
  const hear = () => { heardMs = performance.now(); };
  const tell = () => {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(wish()));
  };
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    hear();
    socket = new WebSocket(`${scheme}://${location.host}/ws${location.search}`);
    socket.onopen = () => { retryMs = 250; tell(); };
    socket.onmessage = (event) => { hear(); take(JSON.parse(event.data)); };
    socket.onclose = () => {
      hear();
      setTimeout(open, retryMs);
      retryMs = Math.min(2 * retryMs, 2000);
    };
  };
  open();
  setInterval(() => {
    if (performance.now() - heardMs < GIVE_UP_MS) return;
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
    open();
  }, 1000);
  return tell;
}
