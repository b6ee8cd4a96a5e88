/** A sweep's results at a glance: the best so far, and the importance of its axes. */

import { value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { bestSoFar, objectivesOf } from "../../lib/sweep.js";

const [WIDTH, HEIGHT, LEFT, BELOW] = [480, 200, 56, 24];

export function BestSoFar({ sweep, objective }) {
  const points = bestSoFar(sweep, objective);
  const { metric } = objectivesOf(sweep)[objective];
  return html`<section class="card"><h2>Best so far</h2>
    ${points.length ? html`<${Picture} points=${points} metric=${metric} />` : html`<p class="facts">No trial has succeeded yet.</p>`}
  </section>`;
}

function Picture({ points, metric }) {
  const found = points.map(([, own]) => own);
  const [low, high] = [Math.min(...found), Math.max(...found)];
  const last = Math.max(points.at(-1)[0], 1);
  const x = (number) => LEFT + (number / last) * (WIDTH - LEFT - 8);
  const y = (one) => (high > low ? 8 + ((high - one) / (high - low)) * (HEIGHT - BELOW - 16) : (HEIGHT - BELOW) / 2);
  const line = points.flatMap(([number, , best], at) => (at ? [[number, points[at - 1][2]], [number, best]] : [[number, best]]));
  const said = `${metric}: the best of ${points.length} trials is ${value(points.at(-1)[2])}`;
  return html`<svg class="sweep-picture" viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label=${said}>
    ${[low, high].slice(high > low ? 0 : 1).map((one) => html`<g key=${one}>
      <line x1=${LEFT} x2=${WIDTH} y1=${y(one)} y2=${y(one)} /><text x=${LEFT - 6} y=${y(one) + 4} text-anchor="end">${value(one)}</text>
    </g>`)}
    <text x=${LEFT} y=${HEIGHT - 4}>trial 0</text><text x=${WIDTH - 4} y=${HEIGHT - 4} text-anchor="end">${points.at(-1)[0]}</text>
    <polyline points=${line.map(([at, one]) => `${x(at).toFixed(1)},${y(one).toFixed(1)}`).join(" ")} />
    ${points.map(([number, own]) => html`<circle key=${number} cx=${x(number)} cy=${y(own)} r="3" />`)}
  </svg>
  <p class="facts">${metric} by trial; the line is the best so far.</p>`;
}

export function Importance({ sweep }) {
  const found = Object.entries(sweep.importance || {});
  return html`<section class="card"><h2>Importance of settings</h2>
    ${!found.length && html`<p class="facts">${sweep.importance_note || "It is computed once trials have succeeded."}</p>`}
    ${found.map(([metric, shares]) => html`<div key=${metric}>
      <p class="facts">for ${metric}, by PED-ANOVA</p>
      <ul class="bars">${Object.entries(shares).sort(([, one], [, other]) => other - one).map(([axis, share]) => html`<li key=${axis}>
        <span>${axis}</span>
        <svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true"><rect width=${100 * share} height="8" /></svg>
        <span class="facts">${Math.round(100 * share)} %</span>
      </li>`)}</ul>
    </div>`)}
  </section>`;
}
