-- The tables of a journal. Every _s column counts from the beginning of the night.

CREATE TABLE night (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    title TEXT NOT NULL,
    who TEXT NOT NULL,
    began_utc TEXT NOT NULL,         -- the instant from which every _s column counts
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    seed INTEGER,
    versions TEXT NOT NULL,          -- JSON: programs and libraries
    configuration TEXT NOT NULL,     -- the resolved configuration, as text: what a resume uses, whatever the files say
    steps_total INTEGER NOT NULL,
    digest TEXT NOT NULL             -- SHA-256 over the above and the plan
);
CREATE TABLE steps (                 -- the plan, as data
    number INTEGER PRIMARY KEY,      -- the step's index in the plan
    key TEXT NOT NULL UNIQUE,
    kind TEXT NOT NULL,
    starts_s REAL NOT NULL,
    duration_s REAL NOT NULL,
    temperature_degC REAL,
    self_calibration INTEGER,
    position TEXT,
    parameters TEXT NOT NULL         -- JSON
);
CREATE TABLE controllers (           -- one row per controller process that has worked on this night
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    pid INTEGER NOT NULL,
    host TEXT NOT NULL,
    who TEXT NOT NULL,
    began_s REAL NOT NULL,
    seen_s REAL NOT NULL,            -- campaign time of its last write
    seen_utc TEXT NOT NULL,          -- wall time of its last write, by the operating system's clock even in simulation
    ended TEXT                       -- how it ended, in words; NULL while it lives, or after it was killed
);
CREATE TABLE attempts (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    step_key TEXT NOT NULL REFERENCES steps (key),
    attempt INTEGER NOT NULL CHECK (attempt >= 1),
    controller INTEGER NOT NULL REFERENCES controllers (id),
    began_s REAL NOT NULL,
    ended_s REAL,
    outcome TEXT CHECK (outcome IN ('DONE', 'FAILED', 'ERROR', 'TIMEOUT', 'ABORTED')),  -- NULL: never ended
    reason TEXT,
    data TEXT,                       -- JSON
    digest TEXT,                     -- SHA-256 over what its line in the log says of its end
    withdrawn TEXT,                  -- why a DONE result counts no more: its samples are lost or damaged
    UNIQUE (step_key, attempt),
    CHECK ((outcome IS NULL) = (ended_s IS NULL) AND (outcome IS NULL) = (digest IS NULL))
);
CREATE UNIQUE INDEX a_step_is_done_once ON attempts (step_key) WHERE outcome = 'DONE' AND withdrawn IS NULL;
CREATE TABLE blocks (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    step_key TEXT NOT NULL,
    attempt INTEGER NOT NULL,
    kind TEXT NOT NULL,
    path TEXT NOT NULL UNIQUE,
    sha256 TEXT NOT NULL,
    size INTEGER NOT NULL,
    rows INTEGER NOT NULL,
    content_sha256 TEXT NOT NULL,
    UNIQUE (step_key, attempt, kind),
    FOREIGN KEY (step_key, attempt) REFERENCES attempts (step_key, attempt)
);
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    controller INTEGER NOT NULL REFERENCES controllers (id),
    at_s REAL NOT NULL,
    kind TEXT NOT NULL,
    message TEXT NOT NULL,
    evidence TEXT NOT NULL           -- JSON
);
CREATE TABLE heartbeats (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    controller INTEGER NOT NULL REFERENCES controllers (id),
    at_s REAL NOT NULL,
    step_key TEXT NOT NULL REFERENCES steps (key),
    readings TEXT NOT NULL           -- JSON
);
CREATE TRIGGER an_ended_attempt_stays
BEFORE UPDATE OF id, step_key, attempt, controller, began_s, ended_s, outcome, reason, data, digest ON attempts
WHEN OLD.outcome IS NOT NULL
BEGIN SELECT RAISE(ABORT, 'an attempt that has ended is never changed'); END;
CREATE TRIGGER withdrawn_once BEFORE UPDATE OF withdrawn ON attempts
WHEN OLD.withdrawn IS NOT NULL OR OLD.outcome IS NOT 'DONE'
BEGIN SELECT RAISE(ABORT, 'only a result that counts can be withdrawn'); END;
CREATE TRIGGER a_block_stays BEFORE UPDATE ON blocks
BEGIN SELECT RAISE(ABORT, 'a block is never changed'); END;
CREATE TABLE requests (              -- what somebody asked of a running controller, and what it answered
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    controller INTEGER NOT NULL REFERENCES controllers (id),  -- of whom it was asked: never acted upon by another
    kind TEXT NOT NULL CHECK (kind IN ('pause', 'continue', 'abort', 'confirm', 'refuse')),
    who TEXT NOT NULL,
    why TEXT NOT NULL,
    prompt INTEGER,                  -- the question that is answered
    asked_utc TEXT NOT NULL,         -- wall time, by the operating system's clock
    answered_s REAL,                 -- campaign time; NULL while nobody has answered
    accepted INTEGER CHECK (accepted IN (0, 1)),
    answer TEXT,
    CHECK ((answered_s IS NULL) = (accepted IS NULL) AND (answered_s IS NULL) = (answer IS NULL))
);
CREATE INDEX unanswered ON requests (controller) WHERE answered_s IS NULL;
CREATE TRIGGER an_answer_stays BEFORE UPDATE ON requests WHEN OLD.answered_s IS NOT NULL
BEGIN SELECT RAISE(ABORT, 'an answered request is never changed'); END;
CREATE TABLE ledger (                -- one row per commit (hil.records.ledger)
    n INTEGER PRIMARY KEY,
    rows TEXT NOT NULL,              -- JSON: the SHA-256 of every row that it wrote
    link TEXT NOT NULL               -- SHA-256 of the link before and of `rows`
);
