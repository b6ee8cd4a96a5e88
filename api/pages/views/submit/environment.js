/** The form's part about the environment: which, its options, a user's model, and the algorithm's settings. */

import { everyItem, get, send } from "../../lib/api.js";
import { ago, modelName } from "../../lib/format.js";
import { html, useEffect, useId, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { href } from "../../lib/route.js";
import { itemsOf, withoutNull } from "../../lib/schemas.js";
import { Failure, Loading, Prose } from "../../parts/elements.js";
import { Field } from "../../parts/field.js";

/** environment: as `useEnvironment` has it under the document's options, once these are right. */
export function EnvironmentPart({ all, document, set, errors, environments, environment, problem }) {
  const families = byFamily(environments);
  const wrong = errors.filter(({ pointer }) => ["/environment", "/environment/id"].includes(pointer));
  const { id, options: { model } = {} } = document.environment;
  const choose = (event) => set(["environment"], { id: event.target.value });
  const listed = environments.find((one) => one.id === id);
  const options = listed?.options;
  // References in an environment's own schema lead into that schema.
  const here = { ...all, ...(options?.$defs || {}) };
  const isTask = Object.values(options?.properties || {}).some((one) => itemsOf(withoutNull(one, here).schema, here));
  const isShown = ({ pointer }) => errors.some((error) => error.pointer === `/environment${pointer}`);
  return html`<fieldset><legend>Environment</legend>
    <div class="field wide">
      <label for="environment">Environment</label>
      <select id="environment" value=${id} onChange=${choose} aria-invalid=${wrong.length ? "true" : undefined}>
        ${[...families].map(([family, rows]) => html`<optgroup label=${family}>${rows.map((row) => html`<option value=${row.id}>${row.id}</option>`)}</optgroup>`)}
      </select>
      <p class="facts"><${Prose} text=${listed?.description || ""} /></p>
      ${id === "mjcf" && html`<${OwnModels} chosen=${model} choose=${(one) => set(["environment", "options", "model"], one)} />`}
      ${wrong.map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
      ${problem && !(problem.errors?.length && problem.errors.every(isShown)) && html`<${Failure} error=${problem} />`}
    </div>
    ${options && Object.keys(options.properties || {}).length > 0 &&
    html`<${Field} all=${here} document=${document} set=${set} errors=${errors} path=${["environment", "options"]} schema=${options} planned=${{}} isOpen=${isTask} parts=${environment?.parts} />`}
  </fieldset>`;
}

function byFamily(environments) {
  const found = new Map();
  for (const one of environments) found.set(one.family, [...(found.get(one.family) || []), one]);
  return found;
}

const SETTLE_MS = 600;
const PAUSE_MS = 2000;

/** A worker with a job draws after that. */
async function whoDraws(signal) {
  const workers = await everyItem("/workers", { signal }).catch(() => []);
  const jobOf = ({ job, jobs }) => job || jobs[0];
  if (!workers.length || !workers.every(jobOf)) return "A worker draws it…";
  const who = workers.length === 1 ? `the worker, which is busy with job ${jobOf(workers[0])}` : `one of ${workers.length} workers, which are busy with jobs`;
  return `It waits for ${who}.`;
}

/** The preview's document once the stills are drawn. tell: says meanwhile why there are none. */
async function drawn(path, signal, tell) {
  for (;;) {
    try {
      const answer = await send(path, { signal });
      if (answer.status !== 202) return await answer.json();
      tell(await whoDraws(signal));
    } catch (error) {
      if (error.status !== 503) throw error; // No worker yet, or too much to draw: that passes.
      tell(error.message);
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
  }
}

export function Body({ environment }) {
  const [state, setState] = useState({});
  const options = JSON.stringify(environment.options || {});
  useEffect(() => {
    const control = new AbortController();
    const tell = (text) => control.signal.aborted || setState({ text });
    tell("A worker draws it…");
    const timer = setTimeout(() => {
      const query = new URLSearchParams({ options, width: 320, height: 240 });
      drawn(`/environments/${environment.id}/preview?${query}`, control.signal, tell).then(
        (preview) => setState({ preview }),
        (error) => control.signal.aborted || setState({ error }),
      );
    }, SETTLE_MS);
    return () => {
      clearTimeout(timer);
      control.abort();
    };
  }, [environment.id, options]);
  const { preview, error, text } = state;
  return html`<section class="card" aria-label="The body"><h2>${environment.id}</h2>
    ${text && html`<p class="facts" role="status"><${Prose} text=${text} /></p>`}
    ${error && html`<p class="facts"><${Prose} text=${error.message} /></p>`}
    ${preview && html`<div class="stills">${preview.stills.map(
      (still) => html`<figure key=${still.href}><img src=${still.href} alt="${environment.id}, camera ${still.camera}" /><figcaption>${still.camera}</figcaption></figure>`,
    )}</div>`}
  </section>`;
}

const LIMIT = 100;

/** chosen: a model's id, if any; choose: gets the next one. */
export function OwnModels({ chosen, choose }) {
  const id = useId();
  const { data, error, again } = useLive((signal) => get("/models", { limit: LIMIT }, { signal }), []);
  if (!data) return error ? html`<${Failure} error=${error} again=${again} />` : html`<${Loading} what="models" />`;
  const ready = data.items.filter(({ status }) => status === "ready");
  if (!ready.length) return html`<p class="facts">No model is ready: <a href=${href(["models"])}>send one</a>, and choose it here.</p>`;
  return html`<label for=${id}>Model</label>
    <select id=${id} value=${chosen || ""} onChange=${({ target }) => choose(target.value || undefined)}>
      <option value="">choose one</option>
      ${ready.map((model) => html`<option value=${model.id}>${`${modelName(model)} · ${model.id.slice(7, 15)} · ${ago(model.created_at)}`}</option>`)}
    </select>
    ${data.next && html`<p class="facts">These are among the newest ${LIMIT}; <a href=${href(["models"])}>older ones</a> have a button there.</p>`}`;
}

export function AlgorithmPart({ schema, environment, document, ...fields }) {
  const device = document.resources?.accelerator === "gpu" || document.resources?.gpus > 1 ? "gpu" : "cpu";
  const plannedFields = (kind) => environment?.defaults?.[kind]?.[device];
  // What is tuned for a body is what people change first.
  const firstFields = (kind) => [...new Set(["num_timesteps", "learning_rate", ...Object.keys(environment?.tuned?.[kind]?.[device] || {})])];
  const kind = document.algorithm?.kind || "ppo";
  return html`<fieldset><legend>Algorithm</legend>
    ${environment && !plannedFields(kind) && html`<p class="facts">On this environment, ${kind} needs more than its defaults.</p>`}
    <${Field} ...${fields} document=${document} path=${["algorithm"]} schema=${schema} isFilled planned=${{ kind: "ppo" }} plannedFields=${plannedFields} firstFields=${firstFields} />
    <p class="facts">Grey values are those that a job on a ${device.toUpperCase()} takes here.</p>
  </fieldset>`;
}
