"""Pictures of a plan, and the plan as a 3-D scene in the browser."""
