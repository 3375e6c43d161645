"""From a case and its simulator to causes: likelihood, evidence (where the gap lies), and the search among causes."""
