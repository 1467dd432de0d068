-- Aritra's gate: RC channels 9-12, the companion's overrides, to four thrusters on Script1-4.
--
-- A channel's pulse passes, clamped to 1100-1900 us, only while ALL of this holds; else the thruster gets 1500 us:
--   armed; RC input valid (FS_THR_ENABLE = 1: invalid 0.5 s after the last override); mode MANUAL; a value is there.
--
-- Pulses are written with a time-out of 0.2 s over an output that is otherwise held at its trim: if this script
-- stops (error, out of memory, stopped by hand), the thrusters fall to SERVOn_TRIM, which must be 1500.
--
-- Copy it to APM/scripts/ on the autopilot's SD card, load gate.param, reboot. For a boat with other channels or
-- another number of thrusters change the two lists: first thruster first.

local CHANNELS = {9, 10, 11, 12}
local FUNCTIONS = {94, 95, 96, 97} -- SERVOn_FUNCTION: Script1-4
local MIN_US, NEUTRAL_US, MAX_US = 1100, 1500, 1900
local MANUAL = 0
local PERIOD_MS = 10
local LASTS_MS = 200
local RETRY_MS = 2000
local ERROR, INFO = 3, 6

local outputs = {}

local function passes()
  return arming:is_armed() and rc:has_valid_input() and vehicle:get_mode() == MANUAL
end

local function pulse_us(channel, open)
  local value = open and rc:get_pwm(channel)
  if not value or value == 0 then
    return NEUTRAL_US
  end
  return math.max(MIN_US, math.min(MAX_US, value))
end

local function write()
  local open = passes()
  for i, output in ipairs(outputs) do
    SRV_Channels:set_output_pwm_chan_timeout(output, pulse_us(CHANNELS[i], open), LASTS_MS)
  end
end

local function close()
  for _, output in ipairs(outputs) do
    SRV_Channels:set_output_pwm_chan_timeout(output, NEUTRAL_US, LASTS_MS)
  end
end

local function update()
  local fine, problem = pcall(write)
  if fine then
    return update, PERIOD_MS
  end
  pcall(close)
  gcs:send_text(ERROR, "gate: " .. tostring(problem))
  return update, RETRY_MS
end

local function start()
  for i, number in ipairs(FUNCTIONS) do
    local output = SRV_Channels:find_channel(number)
    if not output then
      gcs:send_text(ERROR, "gate: no output has SERVOn_FUNCTION " .. number)
      return start, RETRY_MS
    end
    SRV_Channels:set_angle(number, 1000) -- scaled 0 is then SERVOn_TRIM; without this it would be SERVOn_MIN
    SRV_Channels:set_output_scaled(number, 0)
    outputs[i] = output
  end
  gcs:send_text(INFO, "gate: thrusters on channels " .. table.concat(CHANNELS, " "))
  return update, PERIOD_MS
end

return start()
