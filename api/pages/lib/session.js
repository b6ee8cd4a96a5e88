/** Who is signed in, where the service has accounts. */

import { get, onSignedOut, post, remove } from "./api.js";
import { useEffect } from "./html.js";
import { useLive } from "./live.js";

// Without accounts, and before the service has answered, everybody may do everything.
const ANYBODY = { accounts: false, provider: null, who: null };
let present = ANYBODY;

/** What `GET /session` said last: {accounts, provider, who: {user, role, scope, projects} | null}. */
export const session = () => present;

/** The session, asked for at the start and when a request was refused for want of one; for the frame alone. */
export function useSession() {
  const { data, error, again } = useLive(async (signal) => (present = await get("/session", {}, { signal })), []);
  useEffect(() => onSignedOut(again), []);
  return { session: data || (error ? ANYBODY : null), again };
}

export const signIn = (token) => post("/session", { token });
export const signOut = () => remove("/session");

const ROLES = ["viewer", "submitter", "admin"];
const SCOPES = { viewer: "read", submitter: "submit", admin: "admin" };

/** The lesser of one's role and the session's scope, as a number that grows with what one may do. */
const rank = ({ role, scope }) => Math.min(ROLES.indexOf(role), Object.values(SCOPES).indexOf(scope));

export const isAdmin = () => present.who !== null && rank(present.who) === ROLES.indexOf("admin");

/** Whether one may submit jobs, and add webhooks. */
export const maySubmit = () => !present.accounts || (present.who !== null && rank(present.who) >= ROLES.indexOf("submitter"));

/** Whether one may change, cancel or delete what has this owner. */
export const mayChange = ({ owner }) => !present.accounts || isAdmin() || (maySubmit() && owner === present.who.user);

/** Scopes of tokens that one may make. */
export const scopesToMake = () => [...Object.values(SCOPES).slice(0, rank(present.who) + 1), ...(isAdmin() ? ["worker"] : [])];

export { ROLES };
