/** The fields of a job: its kind, its environment, its algorithm or policy, and everything else in the schema's order. */

import { get } from "../../lib/api.js";
import { at, put } from "../../lib/draft.js";
import { html, useEffect, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Field } from "../../parts/field.js";
import { AlgorithmPart } from "./algorithm.js";
import { EnvironmentPart } from "./environment.js";

const FIRST = ["name", "labels", "seed"];
const PLACED = new Set([...FIRST, "kind", "environment", "algorithm", "policy"]);

/** change: gets a function from the job's document to the next one. environment: what `useEnvironment` returns. */
export function JobFields({ all, document, change, errors, environments, environment }) {
  const set = (path, value) => change((before) => put(before, path, value));
  const fields = { all, document, set, errors };
  const schema = all[document.kind === "rollout" ? "RolloutSpec" : "TrainSpec"];
  const rest = Object.keys(schema.properties).filter((name) => !PLACED.has(name));
  const draw = (name) => html`<${Field} key=${name} ...${fields} path=${[name]} schema=${schema.properties[name]} />`;
  return html`
    <${Kind} document=${document} change=${change} />
    <${EnvironmentPart} ...${fields} environments=${environments} environment=${environment.data} problem=${environment.error} />
    ${document.kind === "rollout"
      ? html`<fieldset><legend>Policy</legend><${Field} ...${fields} path=${["policy"]} schema=${schema.properties.policy} isOpen /></fieldset>`
      : html`<${AlgorithmPart} ...${fields} schema=${schema.properties.algorithm} environment=${environment.data} />`}
    <fieldset><legend>About it</legend><div class="fields">${FIRST.map(draw)}</div></fieldset>
    <fieldset><legend>Everything else</legend><div class="fields">${rest.map(draw)}</div></fieldset>
  `;
}

function Kind({ document, change }) {
  const choose = (kind) => () =>
    change(({ environment, name, labels, seed }) => {
      const kept = Object.fromEntries(Object.entries({ environment, name, labels, seed }).filter(([, value]) => value !== undefined));
      return kind === "train" ? { kind, ...kept } : { kind, ...kept, policy: { kind: "random" } };
    });
  return html`<fieldset><legend>Kind</legend><div class="tools">
    ${[["train", "Train a policy"], ["rollout", "Roll a policy out"]].map(
      ([kind, text]) => html`<label class="inline"><input type="radio" name="kind" checked=${document.kind === kind} onChange=${choose(kind)} /> ${text}</label>`,
    )}
  </div></fieldset>`;
}

/** The chosen environment under the chosen options, with the defaults that fit it. */
export function useEnvironment(chosen) {
  const id = at(chosen, ["id"]);
  const options = JSON.stringify(at(chosen, ["options"]) || {});
  const [settled, setSettled] = useState(options);
  useEffect(() => {
    const timer = setTimeout(() => setSettled(options), 400);
    return () => clearTimeout(timer);
  }, [options]);
  return useLive((signal) => get(`/environments/${id}`, settled === "{}" ? {} : { options: settled }, { signal }), [id, settled]);
}
