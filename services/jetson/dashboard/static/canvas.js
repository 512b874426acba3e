// A canvas in metres: sharp on any screen, colours from the page's theme.
export function prepare(id) {
  const canvas = document.getElementById(id);
  const scale = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
  if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  return { pen, width, height, colour: (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() };
}

export const LEVEL_COLOURS = { SAFE: "safe-text", CAUTION: "caution-text", IMMINENT: "imminent-text" };

// Decode {"dtype", "shape", "data"} arrays: the server sends them as plain lists.
export const list = (array) => (Array.isArray(array) ? array : []);
