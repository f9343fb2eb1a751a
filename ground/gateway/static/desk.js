// Commanding: choose, fill in, look at it once more, confirm; then the daemon's own verification.
function makeDesk(place, words) {
  const add = (parent, kind, text = '', more = {}) => {
    const item = Object.assign(document.createElement(kind), more);
    item.textContent = text;
    parent.append(item);
    return item;
  };
  if (!words.may_command) {
    add(place, 'p', 'This page may look only: the server was started without --command.', { className: 'faint' });
    return;
  }
  const choice = add(add(place, 'label', 'Telecommand'), 'select', '', { id: 'command' });
  for (const { name } of words.commands) add(choice, 'option', name, { value: name });
  const doc = add(place, 'p', '', { className: 'faint' });
  const form = add(place, 'div');
  const buttons = add(place, 'div', '', { id: 'buttons' });
  const outcome = add(place, 'pre', '', { id: 'outcome' });
  const chosen = () => words.commands.find(({ name }) => name === choice.value);
  const given = () => Object.fromEntries([...form.querySelectorAll('[name]')].map((field) => [field.name, field.value]));
  const shown = (values) => Object.entries(values).map(([key, value]) => `${key}=${value}`).join(' ');

  function fill() {
    const command = chosen();
    doc.textContent = [command.doc, command.warning].filter(Boolean).join('. ');
    form.replaceChildren();
    for (const { name, labels, doc: about } of command.arguments) {
      const label = add(form, 'label', about ? `${name} (${about})` : name);
      if (!labels.length) add(label, 'input', '', { name });
      else for (const part of [add(label, 'select', '', { name })]) labels.forEach((one) => add(part, 'option', one, { value: one }));
    }
    ask();
  }

  function ask() {
    buttons.replaceChildren();
    add(buttons, 'button', 'Prepare', { id: 'prepare' }).onclick = () => {
      const command = chosen(), values = given();
      outcome.textContent = '';
      buttons.replaceChildren();
      add(buttons, 'p', `Send ${command.name} ${shown(values)}?`.replace(' ?', '?'), { className: 'medium event' });
      add(buttons, 'button', 'Confirm and send', { id: 'confirm', className: 'do' }).onclick = () => send(command.name, values);
      buttons.append(' ');
      add(buttons, 'button', 'Cancel', { id: 'cancel' }).onclick = ask;
    };
  }

  async function send(name, values) {
    buttons.replaceChildren();
    outcome.textContent = `${name}: sent, waiting for its verification ...`;
    try {
      const answer = await fetch('command', {
        method: 'POST',
        headers: { 'Content-Type': 'application/json' },
        body: JSON.stringify({ name, arguments: values, confirmed: true })
      });
      const told = await answer.json();
      const lines = [...(told.reports ?? []), ...(told.answers ?? [])].map(
        ({ packet, values: found }) => `${packet.replaceAll('_', ' ')}  ${shown(found)}`);
      outcome.textContent = [`${name}: ${told.outcome ?? told.error}`, ...lines].join('\n');
    } catch {
      outcome.textContent = `${name}: no answer from the gateway; events say whether the command was executed`;
    }
    ask();
  }
  choice.onchange = fill;
  fill();
}
