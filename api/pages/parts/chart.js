/** Curves in one picture (uPlot), which follow the colours and the width of the page. */

import { TIME_INCREMENTS, compact, count, duration, stepTicks, ticks, timeTicks, value } from "../lib/format.js";
import { html, useEffect, useRef } from "../lib/html.js";
import { colour, useDark } from "../lib/theme.js";
import uPlot from "../vendor/uplot.js";

const MOST_EDGES = 4; // Of more lines, the legend leaves out the edges of bands.

/**
 * @typedef {{label: string, xs: number[], ys: (number | null)[], colour: string, faint?: boolean, isDashed?: boolean,
 *   edge?: "upper" | "lower"}} Line edge: of a band; the upper one stands before the lower one, and between them it is filled.
 * @param {{title: string, lines: Line[], x: "steps" | "time", log: boolean, range: number[] | null,
 *   onRange: (range: number[] | null) => void, height?: number, sync?: string}} chart
 *   range: the part of the x axis that is shown; dragging over the picture asks for another.
 */
export function Chart(chart) {
  const { title, lines, x, log, range, height = 220 } = chart;
  const place = useRef();
  const plot = useRef(null);
  const latest = useRef(chart);
  latest.current = chart;
  const dark = useDark();
  const data = table(lines, log);
  const isEmpty = data.length < 2 || !data.slice(1).some((ys) => ys.some((y) => y !== null && y !== undefined));

  useEffect(() => {
    if (isEmpty) return undefined;
    const width = place.current.clientWidth;
    const made = new uPlot(options(latest, lines, { x, log, width, height }), data, place.current);
    plot.current = made;
    const observer = new ResizeObserver(([entry]) => made.setSize({ width: Math.floor(entry.contentRect.width), height }));
    observer.observe(place.current);
    return () => {
      observer.disconnect();
      made.destroy();
      plot.current = null;
    };
  }, [isEmpty, dark, x, log, height, JSON.stringify(lines.map((line) => [line.label, line.colour, line.faint, line.edge]))]);

  useEffect(() => {
    const made = plot.current;
    if (!made) return;
    made.setData(data, false);
    const xs = data[0];
    const [min, max] = range || [xs[0], xs.at(-1)];
    made.batch(() => {
      made.setScale("x", min < max ? { min, max } : { min: min - 1, max: max + 1 });
    });
  });

  return html`<figure class="chart" role="group" aria-label=${title}>
    <h2>${title}</h2>
    ${isEmpty
      ? html`<p class="none">${log ? "No values above zero to show on a log axis." : "No values yet."}</p>`
      : html`<div ref=${place} role="img" aria-label=${summary(title, lines)}></div>`}
  </figure>`;
}

/** uPlot's table: all x values, then each line's values at these. */
function table(lines, log) {
  const tables = lines.map(({ xs, ys }) => [xs, log ? ys.map((y) => (y > 0 ? y : null)) : ys]);
  if (!tables.length) return [[]];
  const isShared = tables.every(([xs]) => xs === tables[0][0]);
  return isShared ? [tables[0][0], ...tables.map(([, ys]) => ys)] : uPlot.join(tables);
}

function options(latest, lines, { x, log, width, height }) {
  const [ink, grid] = [colour("--soft"), colour("--line")];
  const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, font: "12px system-ui, sans-serif" };
  const isTime = x === "time";
  const xTicks = isTime ? timeTicks : stepTicks;
  return {
    width,
    height,
    scales: { x: { time: false, auto: false }, y: log ? { distr: 3, log: 10 } : {} },
    axes: [
      { ...axis, size: 28, values: (_, found, ...[, , increment]) => xTicks(found, increment), incrs: isTime ? TIME_INCREMENTS : undefined, space: 80 },
      { ...axis, size: 58, values: (_, found, ...[, , increment]) => (log ? found.map((one) => (one === null ? "" : value(one))) : ticks(found, increment)) },
    ],
    series: [
      { label: isTime ? "Time" : "Step", value: (_, one) => (one === null ? "–" : isTime ? duration(one) : count(one)) },
      ...lines.map((line) => ({
        label: line.label,
        class: line.edge && lines.length > MOST_EDGES ? "unlisted" : undefined,
        stroke: line.faint ? faded(colour(line.colour)) : colour(line.colour),
        width: line.edge ? 0 : line.faint ? 1 : 1.75,
        dash: line.isDashed ? [8, 5] : undefined,
        points: { show: line.xs.length < 2 && !line.edge },
        value: (_, one) => value(one),
      })),
    ],
    bands: lines.flatMap((line, i) =>
      line.edge === "upper" ? [{ series: [i + 1, i + 2], fill: faded(colour(line.colour), 0.2) }] : [],
    ),
    legend: { markers: { dash: (_, i) => (lines[i - 1]?.isDashed ? "dashed" : "solid") } },
    cursor: {
      sync: latest.current.sync ? { key: latest.current.sync } : undefined,
      drag: { x: true, y: false, setScale: false },
      bind: { dblclick: () => () => latest.current.onRange?.(null) },
    },
    hooks: {
      setSelect: [
        (plot) => {
          const { left, width: chosen } = plot.select;
          if (chosen < 4) return;
          const ends = [plot.posToVal(left, "x"), plot.posToVal(left + chosen, "x")];
          plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          latest.current.onRange?.(ends);
        },
      ],
    },
  };
}

const faded = (found, share = 0.35) => found.replace(/^rgb\((.*)\)$/, `rgba($1, ${share})`);

/** The picture in words, for readers who do not see it. */
function summary(title, lines) {
  const parts = lines.filter((line) => !line.faint && !line.edge).map(({ label, xs, ys }) => {
    const found = ys.filter((y) => typeof y === "number");
    if (!found.length) return `${label}: no values`;
    const least = found.reduce((a, b) => Math.min(a, b));
    const greatest = found.reduce((a, b) => Math.max(a, b));
    return `${label}: last ${value(found.at(-1))} at ${compact(xs.at(-1))}, least ${value(least)}, greatest ${value(greatest)}`;
  });
  return `${title}. ${parts.join(". ")}`;
}
