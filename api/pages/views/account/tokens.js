/** Tokens: made, with the secret shown once; listed; revoked. */

import { get, post, remove } from "../../lib/api.js";
import { useSubmission } from "../../lib/draft.js";
import { ago, moment } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { scopesToMake, session } from "../../lib/session.js";
import { Confirm, Copy, Failure, Loading } from "../../parts/elements.js";

// What a token of each scope is for.
const MEANINGS = {
  read: "read: looks, for notebooks and dashboards",
  submit: "submit: also submits, cancels and deletes what is yours",
  admin: "admin: everything that you may",
  worker: "worker: lets a machine join as a worker, and nothing else",
};
const LIVES = { 7: "a week", 90: "90 days", 365: "a year", "": "for ever" };

/** The query's `user`: whose, for an admin. */
export function Tokens({ query }) {
  const user = query.get("user") || session().who.user;
  const { data, error, again } = useLive((signal) => get("/tokens", { user }, { signal }), [user]);
  const isOwn = user === session().who.user;
  return html`
    ${!isOwn && html`<p>Tokens of <strong>${user}</strong>. <a href="#/account">Your own</a></p>`}
    <${NewToken} user=${user} isOwn=${isOwn} onMade=${again} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="tokens" />`}
    ${data && !data.items.length && html`<p class="facts">No tokens yet.</p>`}
    ${data?.items.length > 0 && html`<div class="card table stacking" tabindex="0" role="region" aria-label="Tokens"><table>
      <thead><tr><th>Token</th><th>Scope</th><th>Made</th><th>Expires</th><th>Last used</th><th>State</th></tr></thead>
      <tbody>${data.items.map((token) => html`<${Row} key=${token.id} token=${token} again=${again} />`)}</tbody>
    </table></div>`}
  `;
}

function Row({ token, again }) {
  const [problem, setProblem] = useState(null);
  const revoke = () => remove(`/tokens/${token.id}`).then(again, setProblem);
  const isOver = token.expires_at && new Date(token.expires_at) < new Date();
  const isThis = token.id === session().who.token;
  return html`<tr>
    <td data-label="Token"><span><code>${token.id}</code> ${token.name}${isThis && html` <span class="facts">(of this session)</span>`}</span></td>
    <td data-label="Scope">${token.scope}</td>
    <td data-label="Made">${ago(token.created_at)}</td>
    <td data-label="Expires">${token.expires_at ? moment(token.expires_at) : "never"}</td>
    <td data-label="Last used">${token.last_used_at ? ago(token.last_used_at) : "never"}</td>
    <td data-label="State">${token.revoked_at
      ? html`<span class="facts">revoked ${ago(token.revoked_at)}</span>`
      : isOver
        ? html`<span class="facts">expired</span>`
        : html`<span><${Confirm} text="Revoke" question=${isThis ? "End this session, too?" : "Nothing accepts it any more. Revoke it?"} onYes=${revoke} isDangerous /></span>`}
      ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
    </td>
  </tr>`;
}

function NewToken({ user, isOwn, onMade }) {
  const scopes = scopesToMake();
  const [draft, setDraft] = useState({ name: "", scope: scopes.includes("submit") ? "submit" : scopes[0], expires_in_days: "90" });
  const [made, setMade] = useState(null);
  const set = (name) => ({ target }) => setDraft((before) => ({ ...before, [name]: target.value }));
  const send = { ...draft, expires_in_days: draft.expires_in_days ? Number(draft.expires_in_days) : null, ...(!isOwn && { user }) };
  const { problem, isBusy, reset, submit } = useSubmission(async () => {
    setMade(await post("/tokens", send));
    setDraft((before) => ({ ...before, name: "" }));
    reset();
    onMade();
  }, send);
  return html`<form class="card stack" onSubmit=${submit} novalidate aria-label="Make a token">
    <h2>Make a token</h2>
    <div class="tools">
      <label>Name <input value=${draft.name} maxlength="100" onInput=${set("name")} placeholder="notebook" /></label>
      <label>Scope <select value=${draft.scope} onChange=${set("scope")}>${scopes.map((scope) => html`<option key=${scope} value=${scope}>${MEANINGS[scope]}</option>`)}</select></label>
      <label>Lives <select value=${draft.expires_in_days} onChange=${set("expires_in_days")}>${Object.entries(LIVES).map(([days, text]) => html`<option key=${days} value=${days}>${text}</option>`)}</select></label>
      <button class="main" disabled=${isBusy}>Make it</button>
    </div>
    ${problem && html`<p class="error" role="alert">${problem.message}</p>`}
    ${made && html`<div role="status" class="stack secret">
      <p>The token ${made.id}. <strong>It is shown this once</strong>: copy it now, into <code>gaitway login</code>, <code>GAITWAY_TOKEN</code> or a password manager.</p>
      <${Copy} text=${made.secret} name="The token" />
    </div>`}
  </form>`;
}
