/** Which kind of ground a body walks on, and how hard it is. */

import { html } from "../../lib/html.js";

/** @param {object[]} layouts See docs/push.md. @param {number} chosen The number of one. @param {(number) => void} choose */
export function GroundChoice({ layouts, chosen, isReady, choose }) {
  const here = layouts[chosen];
  const number = (kind, level) => layouts.findIndex((one) => one.kind === kind && one.level === level);
  const kinds = [...new Set(layouts.map(({ kind }) => kind))];
  const levels = layouts.filter(({ kind }) => kind === here.kind).map(({ level }) => level);
  const select = (label, options, value, at) => html`<label>${label}
    <select value=${value} disabled=${!isReady || options.length < 2} onChange=${(event) => choose(at(event.target.value))}>
      ${options.map((one) => html`<option value=${one}>${String(one).replaceAll("_", " ")}</option>`)}
    </select>
  </label>`;
  return html`${select("Ground", kinds, here.kind, (kind) => number(kind, here.level))}
    ${select("Level", levels, here.level, (level) => number(here.kind, Number(level)))}`;
}
