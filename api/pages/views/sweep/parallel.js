/** Parallel coordinates: a vertical axis for each setting and for the objective, a line for each trial. */

import { value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { axesOf, objectivesOf, short, told } from "../../lib/sweep.js";

const [SPACE, SIDE, TOP, HEIGHT] = [200, 60, 34, 260];

export function Parallel({ sweep, picked }) {
  const trials = sweep.trials.filter((trial) => typeof trial.values[0] === "number");
  if (trials.length < 2) return null;
  const columns = [...axesOf(sweep).map((axis) => setting(sweep, axis, trials)), objective(sweep, trials)];
  const width = 2 * SIDE + SPACE * (columns.length - 1);
  const best = new Set(sweep.best.map((trial) => trial.number));
  const rank = (trial) => (picked.includes(trial.number) ? 2 : best.has(trial.number) ? 1 : 0);
  const ordered = [...trials].sort((one, other) => rank(one) - rank(other)); // What stands out is drawn last.
  const said = `Settings and ${objectivesOf(sweep)[0].metric} of ${trials.length} trials; the table below has the numbers.`;
  return html`<section class="card"><h2>Settings and result</h2>
    <div class="table" tabindex="0" role="region" aria-label="Settings and result">
      <svg class="sweep-picture parallel" viewBox="0 0 ${width} ${HEIGHT}" width=${width} role="img" aria-label=${said}>
        ${columns.map((column, at) => html`<${Axis} key=${column.name} column=${column} x=${SIDE + at * SPACE} />`)}
        ${ordered.map((trial) => html`<polyline key=${trial.number} class=${["", "best", "picked"][rank(trial)]}
          points=${columns.map((column, at) => `${SIDE + at * SPACE},${down(column.share(trial)).toFixed(1)}`).join(" ")}>
          <title>trial ${trial.number}: ${value(trial.values[0])}</title>
        </polyline>`)}
        ${columns.map((column, at) => html`<${Ticks} key=${column.name} column=${column} x=${SIDE + at * SPACE} />`)}
      </svg>
    </div>
    <p class="facts">The best trial is drawn thick; those that are picked in the table, too, in another colour.</p>
  </section>`;
}

const down = (share) => TOP + (1 - share) * (HEIGHT - TOP - 24);

const Axis = ({ column, x }) => html`<g>
  <line x1=${x} x2=${x} y1=${down(1)} y2=${down(0)} />
  <text x=${x} y="14" text-anchor="middle">${column.name}</text>
</g>`;

/** Drawn after the lines, so that none crosses a number. */
const Ticks = ({ column, x }) => html`<g>
  ${column.ticks.map(([share, text]) => html`<text key=${text} class="tick" x=${x + 5} y=${down(share) + 4}>${text}</text>`)}
</g>`;

/** name; share: how far up a trial stands, 0 to 1; ticks: [[share, text]]. */
function setting(sweep, axis, trials) {
  const said = sweep.spec.parameters[axis];
  if (!Array.isArray(said)) {
    return numbers(short(axis), said.low, said.high, (trial) => trial.parameters[axis], said.log);
  }
  const texts = said.map(told);
  const share = (at) => (texts.length > 1 ? at / (texts.length - 1) : 0.5);
  const shown = texts.length <= 12 ? texts : texts.filter((_, at) => at === 0 || at === texts.length - 1);
  return {
    name: short(axis),
    share: (trial) => share(texts.indexOf(told(trial.parameters[axis]))),
    ticks: shown.map((text) => [share(texts.indexOf(text)), text]),
  };
}

function objective(sweep, trials) {
  const found = trials.map((trial) => trial.values[0]);
  return numbers(objectivesOf(sweep)[0].metric.split("/").at(-1), Math.min(...found), Math.max(...found), (trial) => trial.values[0]);
}

function numbers(name, low, high, of, isLog) {
  const place = isLog ? Math.log : (one) => one;
  const share = (one) => (high > low ? (place(one) - place(low)) / (place(high) - place(low)) : 0.5);
  return { name, share: (trial) => share(of(trial)), ticks: [...new Set([low, high])].map((one) => [share(one), value(one)]) };
}
