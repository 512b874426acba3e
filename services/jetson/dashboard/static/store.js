// The newest of everything, as the server last told it, and how old each thing is by now.
export const state = { entries: {}, verdicts: [], healths: [], arrivedMs: -Infinity };

export const silentMs = () => performance.now() - state.arrivedMs;

// The newest message of a product on any host, its age now, and the host; null when there never was one.
export function newest(product) {
  const extraMs = silentMs();
  let best = null;
  for (const [key, entry] of Object.entries(state.entries)) {
    if (key.slice(key.indexOf("/") + 1) !== product) continue;
    const ageMs = entry.age_ms + extraMs;
    if (!best || ageMs < best.ageMs) best = { host: key.split("/")[0], ageMs, message: entry.message };
  }
  return best;
}

// One websocket that comes back by itself; it tells the server what this page looks at and how often.
export function connect(wish) {
  let retryMs = 250;
  let socket = null;
  const tell = () => {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(wish()));
  };
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/ws${location.search}`);
    socket.onopen = () => { retryMs = 250; tell(); };
    socket.onmessage = (event) => {
      Object.assign(state, JSON.parse(event.data));
      state.arrivedMs = performance.now();
    };
    socket.onclose = () => {
      setTimeout(open, retryMs);
      retryMs = Math.min(2 * retryMs, 2000);
    };
  };
  open();
  return tell;
}
