/** What a body that follows commands is told and what it does, in the colours of its arrows. */

import { html } from "../../lib/html.js";

const NUMBERS = [
  ["forward", "m/s"],
  ["left", "m/s"],
  ["turn", "rad/s"],
].map(([name, unit]) => ({ name, unit }));

/** @param {number[]} commanded [3 or more]. @param {number[]} measured The same. @param {object[]} ranges Of the command. */
export function Speeds({ ranges = NUMBERS, commanded, measured }) {
  const told = ({ low, high, unit }) => (low === undefined ? null : `Trained from ${low} to ${high} ${unit}`);
  return html`<table class="speeds">
    <thead><tr><th scope="col">Velocity</th><th scope="col" class="commanded">Command</th><th scope="col" class="measured">Measured</th></tr></thead>
    <tbody>${ranges.slice(0, NUMBERS.length).map((range, i) => html`<tr key=${range.name} title=${told(range)}>
      <th scope="row">${range.name}, ${range.unit}</th><td>${commanded[i].toFixed(2)}</td><td>${measured[i].toFixed(2)}</td>
    </tr>`)}</tbody>
  </table>`;
}
