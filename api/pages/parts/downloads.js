/** Curves to keep: a picture, and a table. */

import { colour } from "../lib/theme.js";

const FONT = 'system-ui, "DejaVu Sans", sans-serif';
const [MARGIN, HEAD, LINE, SWATCH] = [14, 44, 20, 22]; // Pixels of the page.

/**
 * @param {HTMLElement} element Holds the chart.
 * @param {{title: string, across: string, up: string, lines: import("./chart.js").Line[]}} told across, up: the axes' names.
 * @returns {Promise<Blob>} A PNG on the page's ground, as sharp as the screen.
 */
export function pictureOf(element, { title, across, up, lines }) {
  const plot = element.querySelector("canvas");
  const [width, height] = [plot.clientWidth, plot.clientHeight];
  const [left, below] = [MARGIN + LINE, HEAD + height];
  const picture = document.createElement("canvas");
  const context = picture.getContext("2d");
  const whole = left + width + MARGIN;
  const entries = legend(context, lines, whole - 2 * MARGIN);
  const sharpness = plot.width / width;
  picture.width = Math.round(whole * sharpness);
  picture.height = Math.round((below + LINE + (entries.at(-1).row + 1) * LINE + MARGIN) * sharpness);
  context.scale(sharpness, sharpness);
  context.fillStyle = colour("--card");
  context.fillRect(0, 0, whole, picture.height);
  context.drawImage(plot, left, HEAD, width, height);
  context.textBaseline = "middle";
  write(context, title, MARGIN, HEAD / 2, whole - 2 * MARGIN, `600 16px ${FONT}`, "--ink");
  context.textAlign = "center";
  write(context, across, left + width / 2, below + LINE / 2, width, small, "--soft");
  context.save();
  context.translate(MARGIN + LINE / 2, HEAD + height / 2);
  context.rotate(-Math.PI / 2);
  write(context, up, 0, 0, height, small, "--soft");
  context.restore();
  context.textAlign = "left";
  for (const { line, x, row } of entries) {
    const y = below + LINE + (row + 0.5) * LINE;
    context.fillStyle = colour(line.colour);
    for (const [from, to] of line.isDashed ? [[0, 9], [13, SWATCH]] : [[0, SWATCH]]) {
      context.fillRect(MARGIN + x + from, y - 2, to - from, 4);
    }
    write(context, line.label, MARGIN + x + SWATCH + 6, y, whole - 2 * MARGIN - SWATCH - 6, small, "--ink");
  }
  return new Promise((resolve) => picture.toBlob(resolve, "image/png"));
}

const small = `13px ${FONT}`;

/** room: pixels, into which a longer text is pressed. */
function write(context, text, x, y, room, font, ink) {
  context.font = font;
  context.fillStyle = colour(ink);
  context.fillText(text, x, y, room);
}

/** The place of each line's name, in rows no wider than `width`; edges of bands have the name of their mean. */
function legend(context, lines, width) {
  context.font = small;
  let [x, row] = [0, 0];
  return lines.filter((line) => !line.edge && !line.faint).map((line) => {
    const own = SWATCH + 6 + Math.ceil(context.measureText(line.label).width) + 18;
    if (x && x + own > width) [x, row] = [0, row + 1];
    x += own;
    return { line, x: x - own, row };
  });
}

/** Offer a blob as a download. */
export function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** A field of CSV (RFC 4180). A name that a spreadsheet would run as a formula gets an apostrophe in front. */
const field = (value) => {
  const text = typeof value === "string" && /^[=+\-@\t\r]/.test(value) ? `'${value}` : String(value ?? "");
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

/** Curves of one metric as a table: a line for each value. curves: pairs of a job and its curve. */
export function toCsv(curves, metric) {
  const rows = curves.flatMap(([job, curve]) =>
    (curve?.steps || []).map((step, i) => [job.id, job.label, step, new Date(curve.times[i]).toISOString(), curve.values[i]]),
  );
  return [["job", "name", "step", "time", metric], ...rows].map((row) => row.map(field).join(",")).join("\r\n") + "\r\n";
}
