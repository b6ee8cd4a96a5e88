"""The writes that must be all or nothing, as Redis runs them.

Every script answers with a word. A client that lost the answer sends the same call again: the identity of
the write (`nonce`), kept in the record, makes the second one find the first instead of doing it twice.
A job's hash: version, document, status, token, progress, nonce, fed (the nonce of the last `record`).
"""

# KEYS: job, index, unfinished, idempotency
# ARGV: id, version, document, status, token, progress, nonce, is_final, prefix of jobs, fingerprint,
#       remembered_ms
ADD = """
local job, id, nonce = KEYS[1], ARGV[1], ARGV[7]
if redis.call('HGET', job, 'nonce') == nonce then return {'ok', id} end
if ARGV[10] ~= '' then
  local seen = redis.call('HMGET', KEYS[4], 'fingerprint', 'job')
  if seen[2] and redis.call('EXISTS', ARGV[9] .. seen[2]) == 1 then
    if seen[1] ~= ARGV[10] then return {'reused', id} end
    return {'ok', seen[2]}
  end
end
if redis.call('EXISTS', job) == 1 then return {'exists', id} end
redis.call('HSET', job, 'version', ARGV[2], 'document', ARGV[3], 'status', ARGV[4], 'token', ARGV[5],
  'progress', ARGV[6], 'nonce', nonce)
redis.call('ZADD', KEYS[2], 0, id)
if ARGV[8] == '0' then redis.call('ZADD', KEYS[3], 0, id) end
if ARGV[10] ~= '' then
  redis.call('HSET', KEYS[4], 'fingerprint', ARGV[10], 'job', id)
  redis.call('PEXPIRE', KEYS[4], ARGV[11])
end
return {'ok', id}
"""

# KEYS: job, events, lease, unfinished
# ARGV: id, version, document, status, token, nonce, is_final, lease_ms, entry kind, entry, feed length
SAVE = """
local job, nonce = KEYS[1], ARGV[6]
local stored = redis.call('HMGET', job, 'version', 'status', 'token', 'nonce')
if not stored[1] then return 'missing' end
if stored[4] == nonce then return 'ok' end
if tonumber(stored[1]) ~= tonumber(ARGV[2]) - 1 then return 'stale' end
redis.call('HSET', job, 'version', ARGV[2], 'document', ARGV[3], 'status', ARGV[4], 'token', ARGV[5],
  'nonce', nonce)
if stored[2] ~= ARGV[4] then
  redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[11], '*', 'kind', ARGV[9], 'entry', ARGV[10])
end
if stored[3] ~= ARGV[5] then redis.call('DEL', KEYS[3]) end
if ARGV[5] ~= '' and ARGV[8] ~= '0' then redis.call('SET', KEYS[3], ARGV[5], 'PX', ARGV[8]) end
if ARGV[7] == '1' then redis.call('ZREM', KEYS[4], ARGV[1]) else redis.call('ZADD', KEYS[4], 0, ARGV[1]) end
return 'ok'
"""

# KEYS: job, events, logs, lease, index, unfinished
# ARGV: id, version
DELETE = """
local version = redis.call('HGET', KEYS[1], 'version')
if not version then return 'missing' end
if version ~= ARGV[2] then return 'stale' end
redis.call('DEL', KEYS[1], KEYS[2], KEYS[3], KEYS[4])
redis.call('ZREM', KEYS[5], ARGV[1])
redis.call('ZREM', KEYS[6], ARGV[1])
return 'ok'
"""

# KEYS: job, lease
# ARGV: token, lease_ms
RENEW = """
local stored = redis.call('HMGET', KEYS[1], 'token', 'status')
if ARGV[1] == '' or stored[1] ~= ARGV[1] then return '' end
redis.call('SET', KEYS[2], ARGV[1], 'PX', ARGV[2])
return stored[2]
"""

# KEYS: job, feed
# ARGV: token, nonce, progress, feed length, then kind and entry of each
RECORD = """
local stored = redis.call('HMGET', KEYS[1], 'token', 'fed')
if ARGV[1] == '' or stored[1] ~= ARGV[1] then return 'lost' end
if stored[2] == ARGV[2] then return 'ok' end
for i = 5, #ARGV, 2 do
  redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[4], '*', 'kind', ARGV[i], 'entry', ARGV[i + 1])
end
redis.call('HSET', KEYS[1], 'fed', ARGV[2])
if ARGV[3] ~= '' then redis.call('HSET', KEYS[1], 'progress', ARGV[3]) end
return 'ok'
"""
