#version 330 core
// Labels alone: drawn without anti-aliasing, which would mix them at every outline.
flat in float part;
out vec4 color;
void main() {
  color = vec4(0.0, 0.0, 0.0, part);
}
