/** Models of users: upload one by dropping it, see what a worker found in it. */

import { get, remove, send, withQuery } from "../lib/api.js";
import { ago, bytes, compact, duration, modelName, value } from "../lib/format.js";
import { html, useRef, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { href } from "../lib/route.js";
import { Confirm, Copy, Empty, Failure, Loading, Pages, Prose } from "../parts/elements.js";
import { ProjectChoice, whose } from "../parts/whose.js";

const LIMIT = 50;
const LONGEST_NAME = 100; // Characters, as the service allows.
const LISTS = ["bodies", "joints", "actuators", "sensors", "cameras", "keyframes"];
const isSettling = (model) => model.status === "validating" || (model.status === "ready" && !model.description?.complete);

export default function Models({ query }) {
  const cursor = query.get("cursor");
  const { data, error, again } = useLive(
    (signal) => get("/models", { cursor, limit: LIMIT }, { signal }),
    [cursor],
    (found) => (found.items.some(isSettling) ? 1500 : 15_000),
  );
  return html`<div class="stack">
    <h1>Models</h1>
    <${Drop} onAdded=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="models" />`}
    ${data && !data.items.length && !cursor && html`<${Empty}><p>No models yet. A model is a robot of your own, as MJCF or URDF.</p><//>`}
    ${data && html`<div class="grid">${data.items.map((model) => html`<${Model} key=${model.id} model=${model} again=${again} />`)}</div>`}
    ${data && html`<${Pages} path=${["models"]} query=${query} next=${data.next} name="Pages of models" first="Newest" more="Older models" />`}
  </div>`;
}

function Drop({ onAdded }) {
  const [state, setState] = useState({});
  const [isOver, setOver] = useState(false);
  const [main, setMain] = useState("");
  const [project, setProject] = useState();
  const input = useRef();
  const upload = async (file) => {
    if (!file) return;
    setState({ text: `Sending ${file.name} (${bytes(file.size)}); a worker reads it…` });
    try {
      const type = file.name.toLowerCase().endsWith(".zip") ? "application/zip" : "application/xml";
      const path = withQuery("/models", { name: file.name.slice(0, LONGEST_NAME), main: main.trim(), project });
      const model = await (await send(path, { method: "POST", body: file, type })).json();
      const read = model.description?.main;
      const isThere = read && read !== file.name && type.endsWith("zip") ? `is there, read from ${read}.` : "is there.";
      setState({ text: `${file.name} ${model.status === "validating" ? "waits for a worker to read it; a busy one does so after its job." : isThere}` });
    } catch (error) {
      setState({ error, file });
    }
    input.current.value = "";
    onAdded();
  };
  const drop = (event) => {
    event.preventDefault();
    setOver(false);
    upload(event.dataTransfer.files[0]);
  };
  return html`<section class="drop ${isOver ? "over" : ""}" aria-label="Upload a model"
    onDragOver=${(event) => (event.preventDefault(), setOver(true))} onDragLeave=${() => setOver(false)} onDrop=${drop}>
    <label class="field">Drop an MJCF or URDF file here, or a zip with its meshes; or choose one:
      <input ref=${input} type="file" accept=".xml,.mjcf,.urdf,.zip" onChange=${(event) => upload(event.target.files[0])} />
    </label>
    <label class="field">Of a zip with several documents, the one that is the model (such as scene.xml):
      <input value=${main} onInput=${(event) => setMain(event.target.value)} />
    </label>
    <${ProjectChoice} value=${project} onChange=${setProject} />
    <p role="status">${state.text || ""}</p>
    ${state.error && html`<${Failure} error=${state.error} />`}
    ${state.file && html`<p><button type="button" onClick=${() => upload(state.file)}>Send ${state.file.name} again</button></p>`}
  </section>`;
}

function Model({ model, again }) {
  const [error, setError] = useState(null);
  const { description: found } = model;
  const discard = () => remove(model.links.self).then(again, setError);
  return html`<section class="card stack">
    <h2>${modelName(model)}</h2>
    <p class="facts"><span class="status ${model.status === "ready" ? "succeeded" : model.status === "refused" ? "failed" : ""}">${model.status}</span>
      ${` · ${bytes(model.size)} · ${ago(model.created_at)}${whose(model)}`}</p>
    <p class="facts"><code>${model.id}</code></p>
    ${found?.main && html`<p class="facts">Read from ${found.main}</p>`}
    ${model.message && html`<p class="error"><${Prose} text=${model.message} /></p>`}
    ${found && html`<${Contents} found=${found} />`}
    ${found?.recipe && html`<${Recipe} model=${model} />`}
    ${error && html`<${Failure} error=${error} />`}
    <p class="actions">
      ${found?.recipe && html`<a class="button" href=${href(["submit"], { job: JSON.stringify(walkingJob(model)) })}>Let it walk by command</a>`}
      ${model.status === "ready" && html`<a class=${found?.recipe ? "" : "button"} href=${href(["submit"], { environment: "mjcf", model: model.id })}>${found?.recipe ? "Train it on terms of your own" : "Train it"}</a>`}
      <${Confirm} text="Delete" question="Delete this model?" onYes=${discard} isDangerous />
    </p>
  </section>`;
}

/** A job in which the robot learns to walk by command: `gaitway models show NAME --recipe`. */
const walkingJob = ({ id, description: { recipe } }) => ({ kind: "train", environment: { id: "mjcf", options: { model: id, ...recipe } }, battery: true });

function Recipe({ model }) {
  const { recipe_notes: notes = [] } = model.description;
  return html`<details><summary>A job in which it learns to walk by command</summary>
    ${notes.map((note) => html`<p class="facts"><${Prose} text=${note} /></p>`)}
    <${Copy} text=${JSON.stringify(walkingJob(model), null, 2)} name="The job as JSON" />
  </details>`;
}

/** What the worker found in it. */
function Contents({ found }) {
  const { inventory, engines, notes } = found;
  const { nq, nv, nu } = inventory.sizes;
  const able = Object.keys(engines).filter((name) => engines[name] === null);
  const unable = Object.entries(engines).filter(([, reason]) => reason !== null);
  return html`<dl class="facts-list">
      <dt>Engines</dt><dd>${able.join(", ") || "none yet"}${found.complete ? "" : " (others are still tried)"}</dd>
      ${unable.map(([name, reason]) => html`<dt>not ${name}</dt><dd>does not run it: <${Prose} text=${reason} /></dd>`)}
      ${Object.entries(found.trials ?? {}).map(([name, said]) => html`<dt>${name}, tried</dt><dd>${said}${name in found.code_seconds ? `; made and tried in ${duration(found.code_seconds[name])}` : ""}</dd>`)}
      ${Object.entries(found.auto ?? {}).map(([device, name]) => html`<dt>auto on a ${device.toUpperCase()}</dt><dd>${name}</dd>`)}
      ${Object.keys(found.auto || {}).length > 0 && html`<dt>Chosen</dt><dd>${Object.entries(found.auto).map(([device, name]) => `${name} on a ${device.toUpperCase()}`).join(", ")}</dd>`}
      <dt>Root</dt><dd>${inventory.root}, ${inventory.travels ? "travels" : "stays in its place"}; ${value(inventory.initial_height)} m high, settles at ${value(found.settled_height)} m</dd>
      <dt>Mass</dt><dd>${value(inventory.mass_kg)} kg</dd>
      <dt>Sizes</dt><dd>nq ${nq}, nv ${nv}, nu ${nu}; steps of ${duration(inventory.timestep_s)}</dd>
      <dt>Speed</dt><dd>${compact(found.physics_steps_per_second)} physics steps/s on one core</dd>
      ${LISTS.map((kind) => html`<dt>${kind}</dt><dd><${Names} items=${inventory[kind]} /></dd>`)}
    </dl>
    <${Trials} found=${found} />
    ${notes.map((note) => html`<p class="facts"><${Prose} text=${note} /></p>`)}`;
}

/** A part's name, with an actuator's range, and a sensor's kind with the engines that cannot read it. */
function nameOfPart(item) {
  const name = (item.name ?? item) || "(without a name)";
  if (item.control_range) return `${name} [${item.control_range.map(value).join(", ")}]`;
  const beyond = Object.keys(item.beyond ?? {}).join(", ");
  return item.size ? `${name} (${item.type}${beyond ? `, not on ${beyond}` : ""})` : name;
}

function Names({ items }) {
  if (!items.length) return "none";
  const names = items.map(nameOfPart).join(", ");
  return names.length < 60 ? names : html`<details><summary>${items.length}</summary>${names}</details>`;
}

/** How each engine moved the model beside C MuJoCo, and how long its code took to make. */
function Trials({ found: { trials = {}, code_seconds: made = {} } }) {
  const tried = Object.entries(trials);
  if (!tried.length) return null;
  return html`<details><summary>Trials beside C MuJoCo</summary><dl class="facts-list">
    ${tried.map(([name, said]) => html`<dt>${name}</dt><dd><${Prose} text=${said} />${made[name] === undefined ? "" : ` (its code took ${duration(made[name])} to make)`}</dd>`)}
  </dl></details>`;
}
