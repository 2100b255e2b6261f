"""Workers: `capture`, `detect`, `night`, `calibrating`, `clock_watch`, `upkeep`, `feed`, `push`, `mqtt`."""
