/** How far each joint and each body was off over the time of a clip, as a battery found it: a heat map of each. */

import { get } from "../../lib/api.js";
import { value } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Failure, Loading } from "../../parts/elements.js";

const OPENED_AT_ONCE = 300_000; // Bytes.

/** file: of the battery. */
export function ClipErrors({ file }) {
  const [isOpen, setOpen] = useState(file.size < OPENED_AT_ONCE);
  return html`<details open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
    <summary>Errors over each clip</summary>
    ${isOpen && html`<${Loaded} file=${file} />`}
  </details>`;
}

function Loaded({ file }) {
  const { data, error, again } = useLive((signal) => get(file.href, {}, { signal }), [file.sha256]);
  const [name, setName] = useState(null);
  if (error) return html`<${Failure} error=${error} again=${again} />`;
  if (!data) return html`<${Loading} what="the errors" />`;
  const found = data.over_time;
  if (!found?.clips?.length) return html`<p class="facts">This battery kept none.</p>`;
  const shown = found.clips.find(({ clip }) => clip === name) || found.clips[0];
  const isPart = found.clips.length < data.clips.length;
  return html`<div class="stack">
    <div class="tools"><label>Clip
      <select aria-label="Clip" value=${shown.clip} onChange=${(event) => setName(event.target.value)}>${found.clips.map(({ clip }) => html`<option key=${clip}>${clip}</option>`)}</select>
    </label></div>
    <div class="halves">
      <${HeatMap} key=${`joints ${shown.clip}`} title="Joints" unit="rad" names=${found.joints} rows=${shown.joints} seconds=${shown.seconds} />
      <${HeatMap} key=${`bodies ${shown.clip}`} title="Bodies" unit="m" names=${found.bodies} rows=${shown.bodies} seconds=${shown.seconds} />
    </div>
    <p class="facts">Means over all episodes of the clip, in ${shown.joints.length} parts of its time. Bodies are compared about the reference's anchor.
      ${shown.joints.some((row) => row.includes(null)) && " Grey: no episode was there."}
      ${isPart && ` The ${found.clips.length} clips that are followed worst are kept.`}</p>
  </div>`;
}

/** rows: of each part of the time the errors by name; null where no episode was. */
function HeatMap({ title, unit, names, rows, seconds }) {
  const [said, setSaid] = useState("Point at a cell for its value.");
  const known = (column) => rows.map((row) => row[column]).filter((one) => typeof one === "number");
  const means = names.map((_, column) => known(column).reduce((sum, one) => sum + one, 0) / Math.max(known(column).length, 1));
  const most = Math.max(...names.flatMap((_, column) => known(column)), 1e-9);
  const time = (bin) => ((seconds * bin) / rows.length).toFixed(2);
  const worst = names[means.indexOf(Math.max(...means))];
  const point = ({ target: { dataset } }) => {
    if (dataset.bin === undefined) return;
    const [bin, column] = [Number(dataset.bin), Number(dataset.column)];
    const error = rows[bin][column];
    setSaid(`${names[column]}, ${time(bin)} to ${time(bin + 1)} s: ${typeof error === "number" ? `${value(error)} ${unit}` : "no episode was there"}`);
  };
  return html`<figure class="heat" role="group" aria-label=${`${title}, ${unit}`}>
    <h3>${title}, ${unit}</h3>
    <p class="facts scale">0 <svg viewBox="0 0 10 1" preserveAspectRatio="none" aria-hidden="true">${[...Array(10)].map(
      (_, step) => html`<rect key=${step} x=${step} width="1" height="1" fill-opacity=${(step + 0.5) / 10} />`,
    )}</svg> ${value(most)} ${unit}</p>
    <ul onPointerOver=${point} tabindex="0" aria-label=${`${title}, the mean over ${seconds.toFixed(1)} s; furthest off is ${worst}`}>
      ${names.map(
        (name, column) => html`<li key=${name}>
          <span title=${name}>${name}</span>
          <svg viewBox="0 0 ${rows.length} 1" preserveAspectRatio="none" aria-hidden="true">${rows.map(
            (row, bin) => html`<rect key=${bin} data-bin=${bin} data-column=${column} x=${bin} width="1" height="1"
              ...${typeof row[column] === "number" ? { "fill-opacity": (row[column] / most).toFixed(3) } : { class: "none" }} />`,
          )}</svg>
          <span class="facts">${means[column].toFixed(3)}</span>
        </li>`,
      )}
    </ul>
    <p class="facts axis"><span>0</span><span>${seconds.toFixed(1)} s</span></p>
    <p class="facts" role="status">${said}</p>
  </figure>`;
}
