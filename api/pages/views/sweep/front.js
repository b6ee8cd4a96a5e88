/** Two objectives against each other: a point for each trial, and which trials no other one beats (the Pareto front). */

import { value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { change } from "../../lib/route.js";
import { isMeasured, objectivesOf } from "../../lib/sweep.js";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BELOW] = [480, 260, 64, 8, 24, 44];

export function Front({ sweep, query }) {
  const objectives = objectivesOf(sweep);
  if (objectives.length < 2) return null;
  const trials = sweep.trials.filter((trial) => trial.status === "succeeded" && isMeasured(trial));
  const chosen = (name, otherwise) => {
    const at = objectives.findIndex(({ metric }) => metric === query.get(name));
    return at < 0 ? otherwise : at;
  };
  const [across, up] = [chosen("across", 0), chosen("up", 1)];
  const Select = ({ name, text, at }) => html`<label>${text}
    <select value=${objectives[at].metric} onChange=${(event) => change({ [name]: event.target.value }, true)}>
      ${objectives.map(({ metric }) => html`<option value=${metric}>${metric}</option>`)}
    </select>
  </label>`;
  return html`<section class="card"><h2>Pareto front</h2>
    <div class="tools">${Select({ name: "across", text: "Across", at: across })}${Select({ name: "up", text: "Up", at: up })}</div>
    ${trials.length
      ? html`<${Picture} sweep=${sweep} trials=${trials} across=${across} up=${up} />`
      : html`<p class="facts">No trial has succeeded yet.</p>`}
  </section>`;
}

function Picture({ sweep, trials, across, up }) {
  const objectives = objectivesOf(sweep);
  const front = new Set(sweep.best.map((trial) => trial.number));
  const x = scale(trials.map((trial) => trial.values[across]), LEFT, WIDTH - RIGHT);
  const y = scale(trials.map((trial) => trial.values[up]), HEIGHT - BELOW, TOP);
  const ordered = [...trials].sort((one, other) => front.has(one.number) - front.has(other.number)); // The front is drawn last.
  const name = (at) => `${objectives[at].metric} (${objectives[at].direction === "minimize" ? "less" : "more"} is better)`;
  const said = `${objectives[up].metric} over ${objectives[across].metric} of ${trials.length} trials, of which ${front.size} are the front; the table below has the numbers.`;
  return html`<svg class="sweep-picture front" viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label=${said}>
    ${y.ends.map((one) => html`<g key=${one}><line x1=${LEFT} x2=${WIDTH - RIGHT} y1=${y(one)} y2=${y(one)} />
      <text x=${LEFT - 8} y=${y(one) + 4} text-anchor="end">${value(one)}</text></g>`)}
    ${x.ends.map((one) => html`<g key=${one}><line x1=${x(one)} x2=${x(one)} y1=${TOP} y2=${HEIGHT - BELOW} />
      <text x=${x(one)} y=${HEIGHT - BELOW + 16} text-anchor="middle">${value(one)}</text></g>`)}
    <text x=${LEFT} y="14">${name(up)}</text>
    <text x=${WIDTH - RIGHT} y=${HEIGHT - 8} text-anchor="end">${name(across)}</text>
    ${ordered.map((trial) => html`<circle key=${trial.number} class=${front.has(trial.number) ? "best" : ""}
      cx=${x(trial.values[across]).toFixed(1)} cy=${y(trial.values[up]).toFixed(1)} r=${front.has(trial.number) ? 6 : 3.5}>
      <title>trial ${trial.number}: ${trial.values.map(value).join(", ")}</title>
    </circle>`)}
    ${trials.filter((trial) => front.has(trial.number)).map((trial) => html`<text key=${trial.number} class="tick"
      x=${x(trial.values[across])} y=${y(trial.values[up]) - 10} text-anchor="middle">${trial.number}</text>`)}
  </svg>
  <p class="facts">Large points with a number are the front: trials that no other one beats in ${objectives.length > 2 ? "all objectives" : "both objectives"}.</p>`;
}

/** The place of a value between two edges, with some room beside the first and the last; `ends`: the values there. */
function scale(found, from, to) {
  const [low, high] = [Math.min(...found), Math.max(...found)];
  const place = (one) => from + (high > low ? 0.06 + (0.88 * (one - low)) / (high - low) : 0.5) * (to - from);
  return Object.assign(place, { ends: high > low ? [low, high] : [low] });
}
