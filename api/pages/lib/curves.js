/** A job's metrics in the browser: curves by name, which grow with the job's events. */

import { get } from "./api.js";
import { useEffect, useRef, useState } from "./html.js";

/** @typedef {{steps: number[], times: number[], values: (number | null)[]}} Curve times: ms since 1970. */

export class Curves {
  /** @type {Map<string, Curve>} */
  byName = new Map();

  constructor(rows = []) {
    rows.forEach((row) => this.add(row));
  }

  /** Append a row {step, time, values}. An attempt that began again at a checkpoint replaces what followed it. */
  add({ step, time, values }) {
    const at = new Date(time).getTime();
    for (const [name, value] of Object.entries(values)) {
      if (!this.byName.has(name)) this.byName.set(name, { steps: [], times: [], values: [] });
      const curve = this.byName.get(name);
      while (curve.steps.length && curve.steps.at(-1) >= step) {
        curve.steps.pop();
        curve.times.pop();
        curve.values.pop();
      }
      curve.steps.push(step);
      curve.times.push(at);
      curve.values.push(value);
    }
  }
}

/**
 * A job's curves, live.
 * @param {object} job
 * @param {(listener: (row: object) => void) => () => void} listen Hands on the rows that come from now on.
 * @param {{points: number, metric?: string[], first_step?: number, last_step?: number}} asked
 * @returns {{curves: Curves | null, error: Error | null, version: number}} version: rises with each change.
 */
export function useCurves(job, listen, asked) {
  const [state, setState] = useState({ curves: null, error: null, version: 0 });
  const drawn = useRef(0);
  useEffect(() => {
    const control = new AbortController();
    const early = [];
    let curves = null;
    const changed = () => {
      cancelAnimationFrame(drawn.current);
      drawn.current = requestAnimationFrame(() => setState((s) => ({ curves, error: null, version: s.version + 1 })));
    };
    const stop = listen((row) => {
      if (!curves) return early.push(row); // Rows that come while the others are loaded follow those.
      if (asked.last_step !== undefined && row.step > asked.last_step) return;
      curves.add(only(row, asked.metric));
      changed();
    });
    get(job.links.metrics, asked, { signal: control.signal }).then(
      ({ rows }) => {
        curves = new Curves(rows);
        for (const row of early) curves.add(only(row, asked.metric));
        changed();
      },
      (error) => error.name === "AbortError" || setState((s) => ({ ...s, error })),
    );
    return () => {
      control.abort();
      stop();
      cancelAnimationFrame(drawn.current);
    };
  }, [job.id, JSON.stringify(asked)]);
  return state;
}

const only = (row, names) =>
  names ? { ...row, values: Object.fromEntries(Object.entries(row.values).filter(([name]) => names.includes(name))) } : row;

/** One metric of a job, null where it has none. path: of the job's metrics. asked: points, first_step, last_step. */
export async function curveOf(path, metric, asked, signal) {
  const { rows } = await get(path, { metric, ...asked }, { signal });
  return new Curves(rows).byName.get(metric) || null;
}

/**
 * Exponential moving average that begins at the first value, as TensorBoard's.
 * @param {(number | null)[]} values
 * @param {number} weight 0: as they are; towards 1: smoother.
 */
export function smooth(values, weight) {
  let sum = 0;
  let whole = 0;
  return values.map((value) => {
    if (value === null) return null;
    sum = weight * sum + (1 - weight) * value;
    whole = weight * whole + (1 - weight);
    return sum / whole;
  });
}

/** The x values of a curve: steps, or hours since `start`. */
export const across = (curve, kind, start) =>
  kind === "time" ? curve.times.map((time) => (time - new Date(start)) / 1000) : curve.steps;
