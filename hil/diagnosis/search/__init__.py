"""The search: candidates, their selection and refinement, structure outside the catalogue, the joint fit."""
