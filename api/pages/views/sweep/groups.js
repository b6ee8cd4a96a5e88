/** The seeds of each setting together: their curves as bands, their mean and standard deviation. */

import { curveOf } from "../../lib/curves.js";
import { value } from "../../lib/format.js";
import { html, useRef } from "../../lib/html.js";
import { useInSight } from "../../lib/in_sight.js";
import { bandLines, metricOfSeed } from "../../lib/seeds.js";
import { axesOf, hasJob, isOver, objectivesOf, short, told } from "../../lib/sweep.js";
import { Chart } from "../../parts/chart.js";

const MOST_BANDS = 8; // As many as there are colours.
const MOST_SEEDS = 20; // Whose curves are loaded for one band.
const POINTS = 200;

export function Groups({ sweep, objective }) {
  const all = groupsOf(sweep);
  if (!all.some((group) => group.seeds > 1)) return null;
  const { metric, direction } = objectivesOf(sweep)[objective];
  const sign = direction === "minimize" ? 1 : -1;
  const worth = (group) => (group.mean[objective] === null ? Infinity : sign * group.mean[objective]);
  const groups = [...all].sort((one, other) => worth(one) - worth(other));
  const axes = axesOf(sweep).filter((axis) => axis !== "seed");
  return html`<section class="card stack"><h2>Seeds of one setting together</h2>
    <${Bands} key=${metric} sweep=${sweep} groups=${groups.slice(0, MOST_BANDS)} axes=${axes} metric=${metric} />
    <p class="facts">${limits(groups)}</p>
    <div class="table" tabindex="0" role="region" aria-label="Seeds of one setting together"><table>
      <thead><tr>${axes.map((axis) => html`<th>${axis}</th>`)}<th class="number">Seeds</th><th class="number">${metric}</th></tr></thead>
      <tbody>${groups.map((group) => html`<tr key=${group.trials[0]}>
        ${axes.map((axis) => html`<td>${told(group.parameters[axis])}</td>`)}
        <td class="number">${group.seeds}</td>
        <td class="number">${value(group.mean[objective])}${group.spread[objective] === null ? "" : ` ± ${value(group.spread[objective])}`}</td>
      </tr>`)}</tbody>
    </table></div>
  </section>`;
}

/** Trials of one setting; a trial whose job trains several seeds is one by itself, and its values are their means. */
function groupsOf(sweep) {
  const { seeds } = sweep.spec.job;
  if (!seeds) return sweep.groups.map((group) => ({ ...group, seeds: group.trials.length }));
  const none = objectivesOf(sweep).map(() => null);
  return sweep.trials.map(({ number, parameters, values }) => ({
    parameters, trials: [number], mean: none.map((_, at) => values[at] ?? null), spread: none, seeds: seeds.length,
  }));
}

/** Of what the curves are. */
const limits = (groups) =>
  `Each line is the mean over the seeds of a setting, between the least and the greatest` +
  `${groups.length > MOST_BANDS ? `; the best ${MOST_BANDS} settings are drawn` : ""}` +
  `${groups.some((group) => group.seeds > MOST_SEEDS) ? `; of each, the first ${MOST_SEEDS} seeds` : ""}.`;

/** The curves of each group: their mean, between the least and the greatest. They are loaded in sight, group by group. */
function Bands({ sweep, groups, axes, metric }) {
  const known = useRef(new Map()); // By job and metric: the curve, and the step at which it was loaded.
  const names = sweep.spec.job.seeds?.map((seed) => metricOfSeed(seed, metric)) || [metric];
  const members = groups.map((group) =>
    sweep.trials
      .filter((trial) => group.trials.includes(trial.number) && hasJob(trial) && trial.step > 0)
      .flatMap((trial) => names.map((name) => ({ ...trial, name })))
      .slice(0, MOST_SEEDS),
  );
  const load = async ({ job, step, name }) => {
    const key = `${job} ${name}`;
    if (known.current.get(key)?.step !== step) {
      known.current.set(key, { step, curve: await curveOf(`/jobs/${job}/metrics`, name, { points: POINTS }) });
    }
    return known.current.get(key).curve;
  };
  const loadLines = async () => {
    const lines = [];
    for (const [at, trials] of members.entries()) {
      const curves = (await Promise.all(trials.map(load))).filter(Boolean);
      const setting = axes.map((axis) => `${short(axis)} ${told(groups[at].parameters[axis])}`).join(", ");
      lines.push(...linesOf(curves, setting, `--curve-${at + 1}`));
    }
    return lines;
  };
  const version = members.flat().map(({ number, step }) => `${number} ${step}`).join();
  const [place, lines] = useInSight(loadLines, version, isOver(sweep));
  return html`<div ref=${place} class=${version && "bands"}>${lines && html`<${Chart} title=${metric} lines=${lines} x="steps" log=${false} range=${null} height=${300} />`}</div>`;
}

function linesOf(curves, setting, colour) {
  const lines = curves.map(({ steps, values }) => ({ label: setting || "one seed", xs: steps, ys: values, colour }));
  return lines.length < 2 ? lines : bandLines(lines, `${setting && `${setting}, `}mean of ${lines.length} seeds`);
}
