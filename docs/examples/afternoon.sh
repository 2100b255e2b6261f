#!/bin/sh
# The newest image, its sun mask, a map of the sky and a cloud's place with errors; then waits for a calibration.
# With curl and jq:    sh afternoon.sh http://imager:8080 FOLDER
set -eu
imager=$1
folder=$2

ask() { curl -sSf "$imager/v1/$1"; }
send() { curl -sSf "$imager/v1/$1" -H 'content-type: application/json' -d "$2"; }

newest=$(ask 'images?limit=1' | jq -c '.images[0]')
time=$(echo "$newest" | jq -r .time)
pixel=$(ask status | jq -c '[0.52 * .image_size[0], 0.4 * .image_size[1]]')
ask "images/$time" >"$folder/newest.$(echo "$newest" | jq -r .format)"
ask "masks/sun?at=$time" >"$folder/sun_mask.png"
ask "images/$time/rectified" >"$folder/sky.png"

send "back-project?at=$time" "{\"pixels\": [$pixel]}" |
    jq -r '"direction: zenith \(.zenith_deg[0]), azimuth \(.azimuth_deg[0]), 1-sigma \(.sigma_deg[0]) degrees"'
send "geolocate?at=$time" "{\"pixels\": [$pixel], \"height_m\": 1500, \"height_sigma_m\": 100}" |
    jq -r '{cloud, shadow} | to_entries[] |
        "\(.key): \(.value.latitude[0]), \(.value.longitude[0]), 1-sigma \(.value.sigma_m[0]) m"'

# grep ends after the first event of the kind, and curl with the next sign of life
curl -sN "$imager/v1/events/stream" | grep -m 1 -A 2 '^event: calibration' | sed -n 's/^data: //p' |
    jq -r '"calibration: \(.calibration)"'
