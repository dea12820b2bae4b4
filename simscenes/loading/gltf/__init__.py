"""glTF 2.0 scenes (.gltf, .glb): read whole or refused by name, and described for Mitsuba."""
