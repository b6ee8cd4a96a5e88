/** One axis: a list of values, or a range of numbers. */

import { put } from "../../lib/draft.js";
import { html, useEffect, useId, useRef, useState } from "../../lib/html.js";
import { choicesOf, isNumeric, kindOf } from "../../lib/schemas.js";
import { told } from "../../lib/sweep.js";
import { DEFAULT_POINTS } from "../../lib/sweep_size.js";
import { Field } from "../../parts/field.js";
import { Prose } from "../../parts/elements.js";

/** field: what the axis varies, as `fieldsOf` describes it; undefined where the job has no such field. */
export function Axis({ path, axis, method, field, isKnown, errors, isNew, set, remove }) {
  const box = useRef();
  const id = useId();
  const pointer = `/parameters/${path.replaceAll("~", "~0").replaceAll("/", "~1")}`;
  const wrong = errors.filter((error) => error.pointer === pointer || (error.pointer.startsWith(`${pointer}/`) && /^\d+$/.test(error.pointer.slice(pointer.length + 1))));
  const isRange = !Array.isArray(axis);
  const isRangePossible = isRange || !field || isNumeric(field);
  const choices = field && choicesOf(field);
  const said = wrong.length ? `${id}-error` : undefined;
  useEffect(() => {
    if (isNew) box.current.querySelector("input").focus();
  }, []);
  return html`<fieldset class="axis" ref=${box} aria-describedby=${said}>
    <legend><code>${path}</code></legend>
    <p class="facts">${field ? `${kindOf(field)}; the job has ${field.now === undefined ? "none" : told(field.now)}` : ""}${field?.schema.description && html`. <${Prose} text=${field.schema.description} />`}</p>
    ${!isKnown && html`<p class="error">The job has no such setting: remove this axis, or take another job.</p>`}
    <div class="tools">
      ${isRangePossible && html`<span class="actions" role="group" aria-label="What ${path} takes">
        <button type="button" aria-pressed=${!isRange} onClick=${() => isRange && set([])}>Values</button>
        <button type="button" aria-pressed=${isRange} onClick=${() => isRange || set({})}>A range</button>
      </span>`}
      <button type="button" class="plain remove" onClick=${remove} aria-label="Remove the axis ${path}">Remove</button>
    </div>
    ${isRange && html`<${Range} path=${path} axis=${axis} method=${method} errors=${errors} pointer=${pointer} set=${set} isWrong=${wrong.length > 0} />`}
    ${!isRange && choices && html`<${Choices} choices=${choices} axis=${axis} set=${set} />`}
    ${!isRange && !choices && html`<${Values} path=${path} axis=${axis} field=${field} set=${set} described=${said} />`}
    ${wrong.length > 0 && html`<p class="error" id=${said}><${Prose} text=${wrong.map(({ detail }) => detail).join(" ")} /></p>`}
  </fieldset>`;
}

const NUMBER = { type: "number" };
const PARTS = {
  low: NUMBER,
  high: NUMBER,
  step: { ...NUMBER, description: "Only low, low + step, …" },
  points: { type: "integer", default: DEFAULT_POINTS, description: "This many values, evenly spaced; not with a step." },
};

function Range({ path, axis, method, errors, pointer, set, isWrong }) {
  const names = Object.keys(PARTS).filter((name) => name !== "points" || method === "grid");
  const at = ["parameters", path];
  // Fields know their place by a path, and an axis's name is one part of it.
  const here = errors.filter((error) => error.pointer.startsWith(`${pointer}/`)).map((error) => ({ ...error, pointer: `/${[...at, error.pointer.slice(pointer.length + 1)].join("/")}` }));
  const part = ([, , name], value) => set(put(axis, [name], value));
  return html`<div class="fields narrow">
      ${names.map((name) => html`<${Field} key=${name} all=${{}} document=${{ parameters: { [path]: axis } }} errors=${here} set=${part} path=${[...at, name]} schema=${PARTS[name]} />`)}
    </div>
    <label class="tick"><input type="checkbox" checked=${axis.log === true} aria-invalid=${isWrong ? "true" : undefined} onChange=${({ target }) => set(put(axis, ["log"], target.checked || undefined))} />
      Even in the logarithm: 1e-5 to 1e-4 is as wide as 1e-4 to 1e-3</label>`;
}

/** Boxes for a field that takes a few values. */
function Choices({ choices, axis, set }) {
  const tick = (choice) => () => set(axis.includes(choice) ? axis.filter((one) => one !== choice) : choices.filter((one) => one === choice || axis.includes(one)));
  return html`<div class="ticks">${choices.map(
    (choice) => html`<label class="tick" key=${choice}><input type="checkbox" checked=${axis.includes(choice)} onChange=${tick(choice)} /> ${String(choice)}</label>`,
  )}</div>`;
}

function Values({ path, axis, field, set, described }) {
  const id = useId();
  const [typed, setTyped] = useState(null); // What was typed while it is being typed.
  const type = ({ target }) => {
    setTyped(target.value);
    set(read(target.value));
  };
  return html`<div class="field">
    <label for=${id}>values</label>
    <input id=${id} type="text" value=${typed ?? axis.map((value) => JSON.stringify(value)).join(", ")} placeholder=${example(path, field)}
      aria-describedby=${[`${id}-about`, described].filter(Boolean).join(" ")} aria-invalid=${described ? "true" : undefined}
      onInput=${type} onBlur=${() => setTyped(null)} />
    <p class="facts" id="${id}-about">With commas between them; lists and objects as JSON.</p>
  </div>`;
}

function example(path, field) {
  if (path === "seed") return "1, 2, 3";
  const value = field?.now;
  if (typeof value === "number") return value ? `${value}, ${value * 2}` : "0, 1";
  if (Array.isArray(value)) return `${JSON.stringify(value)}, …`;
  return "…, …";
}

/** Values with commas between them, as JSON where they are; other words are text. */
function read(text) {
  if (!text.trim()) return [];
  try {
    return JSON.parse(`[${text}]`);
  } catch {
    return text.split(",").map((one) => one.trim()).filter(Boolean).map(oneOf);
  }
}

function oneOf(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}
