/** How curves are shown: axis, smoothing, range; kept in the address. */

import { html } from "../lib/html.js";
import { change } from "../lib/route.js";

/** @param {URLSearchParams} query @returns what the tools of this address say. */
export function toolsOf(query) {
  const number = (name) => (query.get(name) === null ? undefined : Number(query.get(name)));
  const [from, to] = [number("from"), number("to")];
  return {
    x: query.get("x") === "time" ? "time" : "steps",
    log: query.get("log") === "1",
    smoothing: Math.min(Math.max(number("smooth") || 0, 0), 0.99),
    range: from !== undefined && to !== undefined && from < to ? [from, to] : null,
  };
}

export const setRange = (range) =>
  change(range ? { from: Math.floor(range[0]), to: Math.ceil(range[1]) } : { from: [], to: [] }, true);

export function CurveTools({ tools, children }) {
  const { x, log, smoothing, range } = tools;
  const set = (parts) => change(parts, true);
  const end = (place) => (event) => {
    const ends = [...(range || [0, 0])];
    ends[place] = Number(event.target.value);
    if (place === 0 && ends[1] <= ends[0]) ends[1] = ends[0] + 1;
    setRange(ends);
  };
  const unit = x === "time" ? "s" : "step";
  return html`<div class="tools" role="group" aria-label="How curves are shown">
    ${children}
    <label>Over
      <select value=${x} onChange=${(event) => set({ x: event.target.value, from: [], to: [] })}>
        <option value="steps">steps</option><option value="time">wall time</option>
      </select>
    </label>
    <label>Smoothing ${smoothing.toFixed(2)}
      <input type="range" min="0" max="0.99" step="0.01" value=${smoothing}
        onInput=${(event) => set({ smooth: Number(event.target.value) ? event.target.value : [] })} />
    </label>
    <label class="inline"><input type="checkbox" checked=${log} onChange=${(event) => set({ log: event.target.checked ? "1" : [] })} /> Log axis</label>
    <span class="actions">
      <label>From (${unit}) <input type="number" min="0" value=${range ? range[0] : ""} onChange=${end(0)} /></label>
      <label>To (${unit}) <input type="number" min="0" value=${range ? range[1] : ""} onChange=${end(1)} /></label>
    </span>
    ${range && html`<button type="button" onClick=${() => setRange(null)}>Show all</button>`}
  </div>`;
}
