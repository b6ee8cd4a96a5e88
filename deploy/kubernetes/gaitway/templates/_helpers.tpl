{{- define "gaitway.name" -}}
{{- .Release.Name | trunc 40 | trimSuffix "-" -}}
{{- end -}}

{{- define "gaitway.labels" -}}
app.kubernetes.io/part-of: gaitway
app.kubernetes.io/managed-by: {{ .Release.Service }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
{{ include "gaitway.selector" . }}
{{- end -}}

{{- define "gaitway.selector" -}}
app.kubernetes.io/name: gaitway
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end -}}

{{/* image: of the service. Arguments: the root, and the image's name. */}}
{{- define "gaitway.image" -}}
{{- $root := index . 0 -}}
{{- with $root.Values.image.registry }}{{ trimSuffix "/" . }}/{{ end }}{{ index . 1 }}:{{ $root.Values.image.tag | default $root.Chart.AppVersion }}
{{- end -}}

{{- define "gaitway.secret" -}}
{{ .Values.stores.secret | default (printf "%s-stores" (include "gaitway.name" .)) }}
{{- end -}}

{{/* A pod of the service; the images' user is 10001. */}}
{{- define "gaitway.pod" -}}
automountServiceAccountToken: false
enableServiceLinks: false
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  seccompProfile: {type: RuntimeDefault}
{{- with .Values.image.pullSecrets }}
imagePullSecrets:
  {{- range . }}
  - name: {{ . }}
  {{- end }}
{{- end }}
{{- end -}}

{{- define "gaitway.confined" -}}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
{{- end -}}

{{/* Settings as variables. Each store's setting is a file of the Secret. */}}
{{- define "gaitway.settings" -}}
- {name: GAITWAY_SECRETS_DIR, value: /run/gaitway}
{{- range $name, $value := . }}
- {name: {{ $name }}, value: {{ $value | toString | quote }}}
{{- end }}
{{- end -}}

{{- define "gaitway.mounts" -}}
- {name: stores, mountPath: /run/gaitway, readOnly: true}
- {name: tmp, mountPath: /tmp}
{{- end -}}

{{- define "gaitway.volumes" -}}
- name: stores
  secret: {secretName: {{ include "gaitway.secret" . }}, defaultMode: 0440}
- {name: tmp, emptyDir: {}}
{{- end -}}

{{- define "gaitway.placed" -}}
{{- with .nodeSelector }}
nodeSelector: {{ toYaml . | nindent 2 }}
{{- end }}
{{- with .tolerations }}
tolerations: {{ toYaml . | nindent 2 }}
{{- end }}
{{- end -}}
