/** Parallel coordinates: a vertical axis for each setting and each objective, a line for each trial. */

import { value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { axesOf, isMeasured, objectivesOf, short, told } from "../../lib/sweep.js";

const [SPACE, TOP, HEIGHT] = [200, 34, 260];

export function Parallel({ sweep, picked }) {
  const trials = sweep.trials.filter(isMeasured);
  if (trials.length < 2) return null;
  const objectives = objectivesOf(sweep);
  const columns = [
    ...axesOf(sweep).map((axis) => setting(sweep, axis)),
    ...objectives.map((_, at) => objective(objectives, at, trials)),
  ];
  const side = Math.max(60, 4 * columns[0].name.length, 4 * columns.at(-1).name.length); // The outer names are centred there.
  const width = 2 * side + SPACE * (columns.length - 1);
  const best = new Set(sweep.best.map((trial) => trial.number));
  const rank = (trial) => (picked.includes(trial.number) ? 2 : best.has(trial.number) ? 1 : 0);
  const ordered = [...trials].sort((one, other) => rank(one) - rank(other)); // What stands out is drawn last.
  const said = `Settings and ${objectives.map(({ metric }) => metric).join(", ")} of ${trials.length} trials; the table below has the numbers.`;
  return html`<section class="card"><h2>Settings and result</h2>
    <div class="table" tabindex="0" role="region" aria-label="Settings and result">
      <svg class="sweep-picture parallel" viewBox="0 0 ${width} ${HEIGHT}" width=${width} role="img" aria-label=${said}>
        ${columns.map((column, at) => html`<${Axis} key=${at} column=${column} x=${side + at * SPACE} />`)}
        ${ordered.map((trial) => html`<polyline key=${trial.number} class=${["", "best", "picked"][rank(trial)]}
          points=${columns.map((column, at) => `${side + at * SPACE},${down(column.share(trial)).toFixed(1)}`).join(" ")}>
          <title>trial ${trial.number}: ${trial.values.map(value).join(", ")}</title>
        </polyline>`)}
        ${columns.map((column, at) => html`<${Ticks} key=${at} column=${column} x=${side + at * SPACE} />`)}
      </svg>
    </div>
    <p class="facts">${objectives.length > 1 ? "Trials of the Pareto front are" : "The best trial is"} drawn thick; those that are picked in the table, too, in another colour.</p>
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
function setting(sweep, axis) {
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

function objective(objectives, at, trials) {
  const found = trials.map((trial) => trial.values[at]);
  const names = objectives.map(({ metric }) => metric.split("/").at(-1));
  const isOnly = names.filter((name) => name === names[at]).length === 1;
  const name = isOnly ? names[at] : objectives[at].metric;
  return numbers(name, Math.min(...found), Math.max(...found), (trial) => trial.values[at]);
}

function numbers(name, low, high, of, isLog) {
  const place = isLog ? Math.log : (one) => one;
  const share = (one) => (high > low ? (place(one) - place(low)) / (place(high) - place(low)) : 0.5);
  return { name, share: (trial) => share(of(trial)), ticks: [...new Set([low, high])].map((one) => [share(one), value(one)]) };
}
