"""The floor: protocol, columns, random streams, schemas, versions. Imports nothing of ours."""
