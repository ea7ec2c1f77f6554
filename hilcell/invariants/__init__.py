"""The invariants of a run, judged from its journal alone, by rules that know no engine."""
