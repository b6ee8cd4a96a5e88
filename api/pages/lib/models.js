/** Models of users, as the service describes them. */

/** The name that it was sent by; or else its body's, or the id's beginning where no worker has read it. */
export const nameOf = ({ id, name, description }) => name || (description ? description.inventory.root : id.slice(0, 19));
