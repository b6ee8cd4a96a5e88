/** The return so far as a small line, loaded once it is in sight. */

import { get } from "../lib/api.js";
import { value } from "../lib/format.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { isOver, lastReturn, RETURNS } from "../lib/job.js";

const WIDTH = 120;
const HEIGHT = 36;
const AT_ONCE = 3; // So that the list's own requests find a connection.
const PAUSE_MS = 4000;

const waiting = [];
let running = 0;

/** Run `task` when fewer than AT_ONCE others run. */
function inTurn(task) {
  waiting.push(task);
  next();
}

function next() {
  if (running >= AT_ONCE || !waiting.length) return;
  running += 1;
  waiting.shift()().finally(() => {
    running -= 1;
    next();
  });
}

async function returns(job) {
  const { rows } = await get(job.links.metrics, { points: 60, metric: RETURNS });
  const name = RETURNS.find((each) => rows.some((row) => typeof row.values[each] === "number"));
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

export function Sparkline({ job }) {
  const [points, setPoints] = useState([]);
  const place = useRef();
  const loaded = useRef({ step: -1, at: 0 });
  const [isSeen, setSeen] = useState(false);
  useEffect(() => {
    const observer = new IntersectionObserver(([entry]) => entry.isIntersecting && setSeen(true));
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  const { step } = job.progress;
  useEffect(() => {
    if (!isSeen || !step || step === loaded.current.step) return undefined;
    const load = () => {
      loaded.current = { step, at: Date.now() };
      inTurn(() => returns(job).then(setPoints, () => (loaded.current.step = -1)));
    };
    const wait = isOver(job) ? 0 : Math.max(0, loaded.current.at + PAUSE_MS - Date.now());
    const timer = setTimeout(load, wait);
    return () => clearTimeout(timer);
  }, [isSeen, step, job.status]);
  const last = lastReturn(job);
  return html`<div class="spark" ref=${place}>
    ${points.length > 1 &&
    html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="Return, from ${value(points[0][1])} to ${value(points.at(-1)[1])}">
      <polyline points=${path(points)} />
    </svg>`}
    ${last !== null && html`<span class="facts">return ${value(last)}</span>`}
  </div>`;
}
