"""The technician's screen: it attaches to an engine, replays and follows its journal."""
