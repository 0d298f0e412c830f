-- The tables of the archive's index.

CREATE TABLE entries (
    name TEXT PRIMARY KEY, stamp TEXT NOT NULL, serial TEXT NOT NULL, trouble TEXT NOT NULL, model TEXT NOT NULL,
    simulated INTEGER NOT NULL, began_utc TEXT NOT NULL, ended_utc TEXT NOT NULL, title TEXT NOT NULL,
    verdict TEXT NOT NULL, reason TEXT NOT NULL, night TEXT NOT NULL, collects INTEGER NOT NULL, whence TEXT NOT NULL,
    settings TEXT NOT NULL, good INTEGER NOT NULL
);
CREATE INDEX entries_of_unit ON entries (serial);
CREATE TABLE means (
    entry TEXT NOT NULL REFERENCES entries (name) ON DELETE CASCADE, sensor INTEGER NOT NULL, parameter TEXT NOT NULL,
    temperature_degC REAL, own_degC REAL, value REAL NOT NULL, sd REAL, freedom REAL, runs INTEGER NOT NULL,
    unit TEXT NOT NULL, beyond REAL
);
CREATE INDEX means_of_entry ON means (entry);
CREATE TABLE settings (digest TEXT PRIMARY KEY, document TEXT NOT NULL);
