/** A job's curve as a small line. */

import { get } from "../lib/api.js";
import { value } from "../lib/format.js";
import { html } from "../lib/html.js";
import { useInSight } from "../lib/in_sight.js";

const WIDTH = 120;
const HEIGHT = 36;

/** The points of the first of these metrics that has some: [[step, value]]. */
async function curve(job, metrics) {
  const { rows } = await get(`/jobs/${job}/metrics`, { points: 60, metric: metrics });
  const name = metrics.find((each) => rows.some((row) => typeof row.values[each] === "number"));
  return rows.filter((row) => typeof row.values[name] === "number").map((row) => [row.step, row.values[name]]);
}

/** The points as SVG coordinates. */
function path(points) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const place = (values, one, size) => {
    const [low, high] = [Math.min(...values), Math.max(...values)];
    return high > low ? ((one - low) / (high - low)) * (size - 4) + 2 : size / 2;
  };
  return points.map(([x, y]) => `${place(xs, x, WIDTH).toFixed(1)},${(HEIGHT - place(ys, y, HEIGHT)).toFixed(1)}`).join(" ");
}

/**
 * @param {{job: string, metrics: string[], step: number, isOver: boolean, name: string}} facts
 *   job: its id; step: of its progress, with which the curve grows; name: what the curve is. Children: a caption.
 */
export function Sparkline({ job, metrics, step, isOver, name, children }) {
  const [place, points] = useInSight(() => curve(job, metrics), step, isOver);
  return html`<div class="spark" ref=${place}>
    ${points?.length > 1 &&
    html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${name}, from ${value(points[0][1])} to ${value(points.at(-1)[1])}">
      <polyline points=${path(points)} />
    </svg>`}
    ${children}
  </div>`;
}
