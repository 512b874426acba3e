// A canvas that is sharp on any screen and grows with the page's text; colours from the page's theme.
// Pixels of the screen per unit of drawing: 1 on a laptop, 2 on a wall.
export const unit = () => parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;

export function prepare(id) {
  const canvas = document.getElementById(id);
  const dots = window.devicePixelRatio || 1;
  const scale = dots * unit();
  const [columns, rows] = [Math.round(canvas.clientWidth * dots), Math.round(canvas.clientHeight * dots)];
  if (canvas.width !== columns) canvas.width = columns;
  if (canvas.height !== rows) canvas.height = rows;
  const [width, height] = [canvas.clientWidth / unit(), canvas.clientHeight / unit()];
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  return { pen, width, height, colour: (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() };
}

export const LEVEL_COLOURS = { SAFE: "safe-text", CAUTION: "caution-text", IMMINENT: "imminent-text" };

// Decode {"dtype", "shape", "data"} arrays: the server sends them as plain lists.
export const list = (array) => (Array.isArray(array) ? array : []);
