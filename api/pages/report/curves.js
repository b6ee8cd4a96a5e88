/** The curves in a report: drawn from values that the file holds, {metric: [steps, values]}. */

import { html, render, useState } from "../lib/html.js";
import { Chart } from "../parts/chart.js";

const RETURNS = ["eval/episode_reward", "training/episode_reward"];

function Curves({ curves }) {
  const [range, setRange] = useState(null);
  const [isOpen, setOpen] = useState(false);
  const returns = RETURNS.filter((name) => name in curves);
  const others = Object.keys(curves).filter((name) => !RETURNS.includes(name));
  const draw = (title, names, height) => {
    const lines = names.map((name, i) => ({ label: name, xs: curves[name][0], ys: curves[name][1], colour: `--curve-${i + 1}` }));
    return html`<${Chart} key=${title} title=${title} lines=${lines} x="steps" log=${false} range=${range} onRange=${setRange} height=${height} sync="curves" />`;
  };
  return html`
    ${returns.length > 0 && draw("Return", returns, 240)}
    <p class="soft">over environment steps · drag over a curve to look closer, double-click to go back</p>
    ${others.length > 0 &&
    html`<details open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
      <summary>${others.length} other metrics</summary>
      ${isOpen && html`<div class="halves">${others.map((name) => draw(name, [name], 180))}</div>`}
    </details>`}
  `;
}

const curves = JSON.parse(document.getElementById("curves-data").textContent);
render(html`<${Curves} curves=${curves} />`, document.getElementById("curves"));
