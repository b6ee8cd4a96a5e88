/** A job's newest poster, which leads to the job. */

import { html } from "../lib/html.js";
import { newest } from "../lib/job.js";
import { href } from "../lib/route.js";

/** job: its document. Children: what stands there while it has no poster. */
export function Thumbnail({ job, children }) {
  const poster = newest(job, "poster");
  return html`<a class="thumbnail" href=${href(["jobs", job.id])} tabindex="-1" aria-hidden="true">
    ${poster ? html`<img src=${poster.href} alt="" loading="lazy" />` : children}
  </a>`;
}
