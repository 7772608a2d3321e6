"""The cell as it is drawn: shells, tissue, table, light, cameras; for films and for the viewer."""
